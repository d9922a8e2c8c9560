//! Planner workers. This crate does not link them: a program that does registers here how to reach them.

use std::{
    path::Path,
    sync::{Arc, OnceLock},
};

use anyhow::{Result, bail};
use wm_model::WorldModel;
use wm_planner::{WorkerCounts, WorkerPool};
use wm_ros::Diagnostics;

/// Reaches the workers with the planner's model at Zenoh endpoints, by a configuration file of Zenoh's if there is one.
pub type ConnectWorkers = fn(&WorldModel, &[String], Option<&Path>) -> Result<Arc<dyn WorkerPool>>;

static CONNECT: OnceLock<ConnectWorkers> = OnceLock::new();

/// Registers how the planner nodes of this process reach workers; only the first call has an effect.
pub fn connect_workers_by(connect: ConnectWorkers) {
    CONNECT.get_or_init(|| connect);
}

/// Those that the parameters name.
pub(super) fn connect(
    model: &WorldModel,
    endpoints: &[String],
    config: &str,
) -> Result<Option<Arc<dyn WorkerPool>>> {
    if endpoints.is_empty() && config.is_empty() {
        return Ok(None);
    }
    let Some(connect) = CONNECT.get() else {
        bail!(
            "parameter workers: this program cannot reach planner workers; build it with \
             cargo build --release -p wm_cli --features workers"
        );
    };
    let config = (!config.is_empty()).then(|| Path::new(config));
    connect(model, endpoints, config).map(Some)
}

/// Reports how they do.
pub(super) fn report(diagnostics: &Diagnostics, counts: WorkerCounts) {
    let figures = [
        ("workers", counts.taking_part as u64),
        ("workers refused", counts.refused as u64),
        ("workers gone [total]", counts.gone),
        ("batches of workers [total]", counts.answered),
        ("batches of workers timed out [total]", counts.timed_out),
        ("batches of workers too late [total]", counts.late),
        ("batches of workers failed [total]", counts.failed),
        ("plans without workers [total]", counts.unshared),
    ];
    for (name, figure) in figures {
        diagnostics.set_value(name, figure);
    }
}
