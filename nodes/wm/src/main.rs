//! `wm`: the whole suite in one program. Every node is a subcommand, and so are the tools around them.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 finished with data lost. Results go to standard output, logs to
//! standard error.

mod bag;
mod cli;
mod eval;
mod launch;
mod model;
mod node;
mod output;
mod report;
mod train;

use std::process::ExitCode;

/// The models allocate and free large tensors at the camera's rate; the system's allocator gives that memory back to
/// the kernel and faults it in again each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Keeps candle to one thread: its own pool spins while it waits and is shared by all threads of the process, so that
/// nodes side by side, or the workers of a training, take each other's processor. Our operations are spread by rayon.
fn keep_candle_to_one_thread() {
    const THREADS: &str = "CANDLE_NUM_THREADS";
    if std::env::var_os(THREADS).is_none() {
        // SAFETY: the first thing that main does; no other thread runs yet that could read the environment.
        unsafe { std::env::set_var(THREADS, "1") };
    }
}

fn main() -> ExitCode {
    keep_candle_to_one_thread();
    let command = cli::parse();
    match command.run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("wm: {error:#}");
            cli::failure_code(&error)
        }
    }
}
