//! What a program of wm needs before and around its work: allocator and threads, progress on a terminal or in a log, and its
//! command line for the completions and man pages of `wm`.

pub mod command_line;
pub mod process;
pub mod progress;
