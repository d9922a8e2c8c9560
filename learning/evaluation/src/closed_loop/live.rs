//! Closed loops through the nodes, in real time.

use std::{path::PathBuf, process::Command};

use anyhow::{Context as _, Result, bail, ensure};

use super::{arguments::ClosedLoopArgs, controller::Controller};

/// The program with the nodes.
const WM: &str = "wm";

/// Runs the episodes with `wm launch`, and copies the findings.
pub fn run(args: &ClosedLoopArgs) -> Result<()> {
    ensure!(
        matches!(args.planner, Controller::Planner(_)),
        "--live needs a planner, but {} is none",
        args.planner
    );
    ensure!(
        args.launch.is_file(),
        "no launch file {}; give the path of arm.launch.yaml with --launch",
        args.launch.display()
    );
    let output = tempfile::tempdir().context("creating a folder for the findings")?;
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
    // 3: a node lost data, and reports it itself.
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
