//! `wm-planner-worker`: the command `wm planner-worker` as a separate program, since Zenoh would slow the build of
//! `wm`.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage.

use std::{io::IsTerminal as _, process::ExitCode};

use anyhow::{Context as _, Result};
use clap::Parser;
use tracing_subscriber::EnvFilter;
use wm_model::trained_folder::EMBEDDED;
use wm_ros::zenoh::NetworkArguments;
use wm_zoo::ModelFolder;

/// Cost candidates for planners on other machines (their parameter `workers`), over Zenoh
#[derive(Debug, Parser)]
#[command(name = "wm-planner-worker", bin_name = "wm planner-worker", version)]
#[command(
    after_help = "Logs go to standard error; RUST_LOG=debug logs more.\nExit codes: 0 done, 1 failed, 2 wrong usage."
)]
struct Cli {
    /// The planner's own model: tiny, or a folder
    #[arg(long, value_name = "MODEL", default_value = EMBEDDED)]
    model: String,
    #[command(flatten)]
    network: NetworkArguments,
}

fn main() -> ExitCode {
    wm_program::process::prepare();
    let cli = Cli::parse();
    let filter = EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| EnvFilter::new("warn,wm_planner_worker=info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
    if let Some(cache) = wm_zoo::PackedCache::of_environment() {
        cache.use_in_process();
    }
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wm planner-worker: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<()> {
    let model = ModelFolder::open(&cli.model)
        .and_then(|folder| folder.world_model())
        .with_context(|| format!("the model {}", cli.model))?;
    let served = wm_planner_worker::serve(&model, &cli.network)?;
    tracing::info!(
        "answered {} batches, refused {} queries",
        served.answered,
        served.refused
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
