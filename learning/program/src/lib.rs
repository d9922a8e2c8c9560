//! Services of wm's programs: allocator and threads, progress on a terminal or in a log, and the description of the command
//! line for the completions and man pages of `wm`.

pub mod command_line;
pub mod process;
pub mod progress;
