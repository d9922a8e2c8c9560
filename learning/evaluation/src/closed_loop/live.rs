//! The same through the nodes, in real time.

use std::{path::PathBuf, process::Command};

use anyhow::{Context as _, Result, bail, ensure};

use super::{arguments::ClosedLoopArgs, controller::Controller};

/// The program with the nodes.
const WM: &str = "wm";

/// Has `wm launch` run the episodes, and copies what came of them.
pub fn run(args: &ClosedLoopArgs) -> Result<()> {
    ensure!(
        matches!(args.planner, Controller::Planner(_)),
        "--live is for planners, which {} is not",
        args.planner
    );
    ensure!(
        args.launch.is_file(),
        "the launch file {} is not there: name arm.launch.yaml with --launch",
        args.launch.display()
    );
    let output = tempfile::tempdir().context("a folder for what comes of it")?;
    let program = program();
    let status = Command::new(&program)
        .arg("launch")
        .arg(&args.launch)
        .args([
            format!("tasks:=[{}]", args.task),
            format!("episodes:={}", args.episodes),
            format!("seed:={}", args.seed),
            format!("planner:={}", args.planner),
            format!("model:={}", args.model),
            "record:=false".to_owned(),
            format!("output:={}", output.path().display()),
        ])
        .status();
    let status = status.with_context(|| format!("starting {}", program.display()))?;
    // 3: a node lost data, which it says itself.
    if !matches!(status.code(), Some(0 | 3)) {
        bail!("{} launch ended with {status}", program.display());
    }
    if let Some(json) = &args.json {
        let found = output.path().join(format!("{}.json", args.task));
        std::fs::copy(&found, json).with_context(|| json.display().to_string())?;
    }
    Ok(())
}

/// The program beside this one, or the one on the PATH.
fn program() -> PathBuf {
    let beside = std::env::current_exe().ok();
    let beside = beside.map(|this| this.with_file_name(WM));
    beside
        .filter(|file| file.is_file())
        .unwrap_or_else(|| WM.into())
}
