//! `wm`: the whole suite in one program. Every node and every tool is a subcommand.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 finished with data lost. Results go to standard output, logs to
//! standard error.

mod bag;
mod cli;
mod completions;
mod doctor;
mod external;
mod init;
mod installed;
mod keys;
mod launch;
mod launch_argument;
mod man;
mod model;
mod node;
mod output;
mod parameter_flags;
mod parameters;
mod report;
mod view;
mod zenoh_router;

use std::process::ExitCode;

fn main() -> ExitCode {
    wm_program::process::prepare();
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
