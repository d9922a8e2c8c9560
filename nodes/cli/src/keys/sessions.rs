//! The session files of a launch's processes.

use super::{identity::file_of, suite};
use anyhow::{Context as _, Result, ensure};
use std::path::{Path, PathBuf};
use wm_launch::Plan;

/// Gives each process its session file in a folder of `wm keys`. A program of another package has one if the launch
/// file names its node; a program without a node's name gets none.
///
/// # Errors
/// A session file is missing; it is named.
pub(crate) fn assign(plan: &mut Plan, folder: &Path) -> Result<()> {
    for process in &mut plan.processes {
        let own = suite::of_process(process)?;
        let name = own.as_ref().map(|identity| &*identity.name);
        if let Some(name) = name.or(process.node.as_deref()) {
            let file = session_file(folder, name)?.to_string_lossy().into_owned();
            let middleware = "rmw_zenoh_cpp".to_owned();
            process.environment.extend([
                ("ZENOH_SESSION_CONFIG_URI".to_owned(), Some(file)),
                ("RMW_IMPLEMENTATION".to_owned(), Some(middleware)),
            ]);
        }
    }
    Ok(())
}

fn session_file(folder: &Path, identity: &str) -> Result<PathBuf> {
    let path = folder.join(file_of(identity));
    ensure!(
        path.is_file(),
        "no session file for {identity}: expected {}; `wm keys DIR --launch FILE` makes one for each process, and \
         --node {identity}=GRANTS for a node of another package",
        path.display()
    );
    std::path::absolute(&path).with_context(|| path.display().to_string())
}
