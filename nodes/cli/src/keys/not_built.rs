//! `wm keys` and `wm launch --keys` in a program without Zenoh.

use super::KeysCommand;
use anyhow::{Result, bail};
use std::{path::Path, process::ExitCode};
use wm_launch::Plan;

const NOT_BUILT: &str = "this program is built without Zenoh: build it with `--features zenoh`";

impl KeysCommand {
    pub(crate) fn run(self, _: Vec<String>) -> Result<ExitCode> {
        bail!(NOT_BUILT)
    }
}

/// # Errors
/// Always.
pub(crate) fn assign(_: &mut Plan, _: &Path) -> Result<()> {
    bail!(NOT_BUILT)
}
