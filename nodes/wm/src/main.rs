//! `wm`: the whole suite in one program. Every node is a subcommand, and so are the tools around them.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 finished with data lost. Results go to standard output, logs to
//! standard error.

mod bag;
mod cli;
mod launch;
mod node;
mod output;
mod report;
mod train;

use std::process::ExitCode;

/// The models allocate and free large tensors at the camera's rate; the system's allocator gives that memory back to
/// the kernel and faults it in again each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    let command = cli::parse();
    match command.run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("wm: {error:#}");
            cli::failure_code(&error)
        }
    }
}
