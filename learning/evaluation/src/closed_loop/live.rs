//! Closed loops through the nodes, in real time.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context as _, Result, bail, ensure};
use serde::Deserialize;
use wm_planner::PlannerChoice;

use super::{arguments::ClosedLoopArgs, controller::Controller};

/// The program with the nodes.
const WM: &str = "wm";

/// Runs the episodes with `wm launch`, and copies the findings.
pub fn run(args: &ClosedLoopArgs) -> Result<()> {
    let Controller::Planner(planner) = args.planner else {
        bail!("--live needs a planner, but {} is none", args.planner);
    };
    ensure!(
        args.launch.is_file(),
        "no launch file {}; give the path of arm.launch.yaml, or of another world's launch file, with --launch",
        args.launch.display()
    );
    let output = tempfile::tempdir().context("creating a folder for the findings")?;
    let arguments = arguments(args, planner, &output.path().display().to_string())?;
    let program = program();
    let mut command = Command::new(&program);
    let status = command
        .arg("launch")
        .arg(&args.launch)
        .args(arguments)
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

/// The arguments of the launch file: those of the episodes, then the user's.
fn arguments(args: &ClosedLoopArgs, planner: PlannerChoice, output: &str) -> Result<Vec<String>> {
    let declared = declared(&args.launch)?;
    // To planners that make subgoals, the last picture is enough.
    let goal_period = if planner.needs_subgoals() {
        "0.0"
    } else {
        "0.4"
    };
    let ours = [
        ("tasks", format!("[{}]", args.task)),
        ("episodes", args.episodes.to_string()),
        ("seed", args.seed.to_string()),
        ("planner", args.planner.to_string()),
        ("model", args.model.clone()),
        ("output", output.to_owned()),
        ("goal_period", goal_period.to_owned()),
        ("record", "false".to_owned()),
    ];
    // Launch files of other worlds may lack these.
    let is_optional = |name: &str| matches!(name, "goal_period" | "record");
    let ours = ours.into_iter();
    let ours = ours.filter(|(name, _)| declared.contains(*name) || !is_optional(name));
    let ours = ours.map(|(name, value)| format!("{name}:={value}"));
    Ok(ours.chain(args.launch_argument.iter().cloned()).collect())
}

/// Names of a launch file's arguments.
fn declared(launch: &Path) -> Result<BTreeSet<String>> {
    #[derive(Deserialize)]
    struct Launch {
        launch: Vec<Entry>,
    }
    #[derive(Deserialize)]
    struct Entry {
        arg: Option<Argument>,
    }
    #[derive(Deserialize)]
    struct Argument {
        name: String,
    }
    let name = || launch.display().to_string();
    let text = std::fs::read_to_string(launch).with_context(name)?;
    let file: Launch = serde_yaml_ng::from_str(&text).with_context(name)?;
    let arguments = file.launch.into_iter().filter_map(|entry| entry.arg);
    Ok(arguments.map(|argument| argument.name).collect())
}

/// The program beside this one, or the one on the PATH.
fn program() -> PathBuf {
    let beside = std::env::current_exe().ok();
    let beside = beside.map(|this| this.with_file_name(WM));
    beside
        .filter(|file| file.is_file())
        .unwrap_or_else(|| WM.into())
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;

    use super::*;

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: ClosedLoopArgs,
    }

    fn given(line: &str) -> Vec<String> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let Line { mut args } = Line::parse_from(line.split(' '));
        args.launch = root.join(&args.launch);
        let Controller::Planner(planner) = args.planner else {
            panic!("{line}");
        };
        arguments(&args, planner, "out").unwrap()
    }

    #[test]
    fn each_world_gets_the_arguments_that_it_declares() {
        let arm = given("wm --task push --planner subgoals+idm --live");
        for expected in ["tasks:=[push]", "goal_period:=0.0", "record:=false"] {
            assert!(arm.contains(&expected.to_owned()), "{arm:?}");
        }
        let alone = given("wm --task push --planner idm --live");
        assert!(alone.contains(&"goal_period:=0.4".to_owned()), "{alone:?}");
        let other = given(
            "wm --task push-v3 --planner idm --live --launch examples/gym/plan.launch.yaml \
             --launch-argument world:=metaworld:push-v3",
        );
        assert!(other.contains(&"tasks:=[push-v3]".to_owned()), "{other:?}");
        assert_eq!(other.last().unwrap(), "world:=metaworld:push-v3");
        let names = ["goal_period", "record"];
        let has = |name: &&str| other.iter().any(|argument| argument.starts_with(*name));
        assert!(!names.iter().any(has), "{other:?}");
    }
}
