//! `wm`: the whole suite in one program. Every node is a subcommand, and so are the tools around them.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 finished with data lost. Results go to standard output, logs to
//! standard error.

mod bag;
mod cli;
mod completions;
mod doctor;
mod external;
mod init;
mod launch;
mod man;
mod model;
mod node;
mod output;
mod report;

use std::process::ExitCode;

/// The models allocate and free large tensors at the camera's rate; the system's allocator gives that memory back to
/// the kernel and faults it in again each time.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Freed memory stays with the process for so many milliseconds: a model that runs at the camera's rate finds its buffers
/// again, whose pages the kernel would else have to clear each time (a tenth of a vision transformer's time), and a
/// node that has become idle still gives them back.
const KEEP_FREED_MS: std::ffi::c_long = 1000;

fn keep_freed_memory() {
    /// `mi_option_purge_delay` of mimalloc.h, which the bindings have no name for.
    const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;
    // SAFETY: an option that exists in the mimalloc that is linked; setting it touches no memory of ours.
    unsafe { libmimalloc_sys::mi_option_set_default(PURGE_DELAY, KEEP_FREED_MS) };
}

/// Keeps candle to one thread: its own pool spins while it waits and is shared by all threads of the process, so that
/// nodes side by side take each other's processor. Our operations are spread by rayon.
fn keep_candle_to_one_thread() {
    const THREADS: &str = "CANDLE_NUM_THREADS";
    if std::env::var_os(THREADS).is_none() {
        // SAFETY: the first thing that main does; no other thread runs yet that could read the environment.
        unsafe { std::env::set_var(THREADS, "1") };
    }
}

fn main() -> ExitCode {
    keep_candle_to_one_thread();
    keep_freed_memory();
    if let Some(cache) = wm_zoo::PackedCache::of_environment() {
        cache.use_in_process();
    }
    #[cfg(feature = "workers")]
    wm_model_nodes::planner::connect_workers_by(wm_planner_worker::connect);
    let command = cli::parse();
    match command.run() {
        Ok(code) => code,
        Err(error) => {
            wm_ros::logging::last_words(format_args!("wm: {error:#}"));
            cli::failure_code(&error)
        }
    }
}
