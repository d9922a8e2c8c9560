//! The running router.

use super::{configuration::listening, occupant};
use anyhow::{Error, Result, anyhow};
use std::process::ExitCode;
use tokio::signal::unix::{SignalKind, signal};

/// The logger's name.
const LOGGER: &str = "zenoh_router";

/// Runs the router until SIGINT or SIGTERM.
///
/// # Errors
/// An endpoint cannot be listened on; the error names the process that uses its port.
pub(super) fn serve(config: zenoh::Config) -> Result<ExitCode> {
    // Zenoh refuses a runtime of the current thread
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    runtime.block_on(route(config))?;
    wm_ros::logging::flush();
    Ok(ExitCode::SUCCESS)
}

async fn route(config: zenoh::Config) -> Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let stop = async {
        tokio::select! {
            _ = interrupt.recv() => "SIGINT",
            _ = terminate.recv() => "SIGTERM",
        }
    };
    tokio::pin!(stop);
    let endpoints = listening(&config)?;
    let session = tokio::select! {
        session = wm_ros::zenoh::open(config) => session.map_err(|error| explained(error, &endpoints))?,
        signal = &mut stop => {
            tracing::info!(target: LOGGER, "ended by {signal}");
            return Ok(());
        }
    };
    tracing::info!(
        target: LOGGER,
        "Zenoh router {} listens on {}",
        session.zid(),
        endpoints.join(", ")
    );
    let signal = stop.await;
    tracing::info!(target: LOGGER, "ended by {signal}");
    let closed = session.close().await;
    closed.map_err(|error| anyhow!("cannot close the Zenoh session: {error}"))
}

/// The error, with the process that uses a port of `endpoints`, if there is one.
fn explained(error: Error, endpoints: &[String]) -> Error {
    let occupied = endpoints.iter().find_map(|endpoint| occupant::of(endpoint));
    match occupied {
        Some(occupied) => error.context(format!("the router cannot start: {occupied}")),
        None => error,
    }
}
