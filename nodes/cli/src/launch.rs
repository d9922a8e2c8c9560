//! `wm launch`.

use crate::{installed, keys, launch_argument, node, output::print};
use anyhow::{Context as _, Result};
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wm_launch::{LaunchError, LaunchFile, Plan, Process, Program, System};
use wm_model::trained_folder::EMBEDDED;
use wm_model_nodes::{decoder, encoder};
use wm_robot_nodes::player;
use wm_ros::{NAMESPACE, NodeArgs};
use wm_zoo::ModelFolder;

/// The nodes' topic of the camera.
pub(crate) const CAMERA: &str = "/camera/image_raw";

/// Starts the nodes of a launch file.
#[derive(Args, Debug)]
pub(crate) struct LaunchCommand {
    /// Launch file in ROS 2's YAML launch format, or the name of an installed one, such as replay.launch.yaml
    file: PathBuf,
    /// Launch arguments
    #[arg(value_name = "NAME:=VALUE", value_parser = launch_argument::parse)]
    arguments: Vec<(String, String)>,
    /// Show the arguments of the launch file
    #[arg(short = 's', long)]
    show_args: bool,
    /// Show the command lines that would be run
    #[arg(short = 'p', long, conflicts_with = "show_args")]
    print_description: bool,
    /// Folder of `wm keys`: each process gets its session file as ZENOH_SESSION_CONFIG_URI
    #[arg(short, long, value_name = "DIR")]
    keys: Option<PathBuf>,
}

impl LaunchCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let file = read(&self.file)?;
        if self.show_args {
            print(wm_launch::describe_arguments(&file))?;
            return Ok(ExitCode::SUCCESS);
        }
        let mut plan = resolved(&file, self.arguments)?;
        if let Some(folder) = &self.keys {
            keys::assign(&mut plan, folder)?;
        }
        if cfg!(feature = "zenoh") {
            plan.router = wm_launch::missing_router(&plan, &System);
        }
        if self.print_description {
            print(describe(&plan)?)?;
            return Ok(ExitCode::SUCCESS);
        }
        check_nodes(&plan)?;
        check_bags(&plan)?;
        // one thread: the kernel binds the processes to the thread that started them
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let outcome = runtime
            .block_on(wm_launch::run(plan))
            .context("the launch")?;
        Ok(ExitCode::from(outcome.exit_code()))
    }
}

/// Reads a launch file by its path, or an installed one by its name.
fn read(file: &Path) -> Result<LaunchFile> {
    Ok(wm_launch::read(&installed::launch_file(file), &System)?)
}

fn resolved(file: &LaunchFile, given: Vec<(String, String)>) -> Result<Plan> {
    let mut arguments = BTreeMap::new();
    for (name, value) in given {
        if let Some(first) = arguments.insert(name.clone(), value) {
            return Err(LaunchError::RepeatedArgument { name, first }.into());
        }
    }
    Ok(Plan::resolve(file, &arguments, &System)?)
}

/// The processes of a launch file with these arguments.
#[cfg(feature = "zenoh")]
pub(crate) fn plan_of(file: &Path, arguments: Vec<(String, String)>) -> Result<Plan> {
    resolved(&read(file)?, arguments)
}

/// Checks that players find their bags before anything starts. A restarted player may wait for its bag.
fn check_bags(plan: &Plan) -> Result<()> {
    let is_own = |process: &&Process| process.program == Program::Own && process.respawn.is_none();
    for process in plan.processes.iter().filter(is_own) {
        if let Some((name, words)) = process.arguments.split_first()
            && name == player::NODE.name
        {
            let folder = process.working_directory.as_deref();
            player::check(&NodeArgs::parse(words)?, folder.unwrap_or(Path::new("")))
                .with_context(|| format!("{} cannot play", process.name))?;
        }
    }
    Ok(())
}

/// Checks models, cameras and ports of the nodes before anything starts: a restarted node would only repeat its error.
fn check_nodes(plan: &Plan) -> Result<()> {
    let is_own = |process: &&Process| process.program == Program::Own;
    for process in plan.processes.iter().filter(is_own) {
        let Some((name, _)) = process.arguments.split_first() else {
            continue;
        };
        if name != node::TOGETHER && !node::is_node(name) {
            continue;
        }
        let args = NodeArgs::parse(&process.arguments)?;
        for node in args.rest().iter().filter(|word| node::is_node(word)) {
            check_camera(node, &args).with_context(|| format!("{} has no camera", process.name))?;
            check_model(node, &args, process.working_directory.as_deref())
                .with_context(|| format!("{} has no model", process.name))?;
            if node == wm_view::NODE.name {
                wm_view::check(&args)?;
            }
        }
    }
    Ok(())
}

/// Nodes take a camera's topic, without `/compressed`.
fn check_camera(node: &str, args: &NodeArgs) -> Result<()> {
    let given: Option<String> = args.given(node, NAMESPACE, "camera_topic")?;
    let several: Option<Vec<String>> = args.given(node, NAMESPACE, "cameras")?;
    // An empty text stands for an empty list.
    let several = several.iter().flatten().map(String::as_str);
    let several = several.filter(|topic| !topic.is_empty());
    for topic in given.as_deref().into_iter().chain([CAMERA]).chain(several) {
        args.resolve_sibling(node, NAMESPACE, topic, "compressed")?;
    }
    Ok(())
}

/// Checks that a model exists and has the parts that the node needs.
fn check_model(node: &str, args: &NodeArgs, folder: Option<&Path>) -> Result<()> {
    if !wm_model_nodes::NODES.iter().any(|known| known.name == node) {
        return Ok(());
    }
    let given: Option<String> = args.given(node, NAMESPACE, "model")?;
    let Some(model) = given.filter(|model| model != EMBEDDED) else {
        return Ok(());
    };
    let model = folder.unwrap_or(Path::new("")).join(model);
    let model = model.to_string_lossy();
    ModelFolder::require(&model)?;
    // these two only need latents
    if ![encoder::NODE.name, decoder::NODE.name].contains(&node) {
        ModelFolder::open(&model)?.require_transition()?;
    }
    Ok(())
}

/// The command lines of a plan, for a shell.
fn describe(plan: &Plan) -> Result<String> {
    let mut text = String::new();
    let router = plan.router.iter().map(|router| &router.process);
    for process in router.chain(&plan.processes) {
        let program = match &process.program {
            Program::Own => std::env::current_exe()?,
            Program::Path(path) => path.clone(),
        };
        text.push_str(&format!("[{}]", process.name));
        let program = program.to_string_lossy().into_owned();
        let words = process.prefix.iter().chain([&program]);
        for word in words.chain(&process.arguments) {
            text.push(' ');
            text.push_str(&quote(word));
        }
        text.push('\n');
    }
    Ok(text)
}

/// Quotes a word for a shell.
pub(crate) fn quote(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_-./:=+,@%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_for_a_shell() {
        assert_eq!(quote("a/b:=1"), "a/b:=1");
        assert_eq!(quote("it's"), "'it'\\''s'");
        assert_eq!(quote(""), "''");
    }
}
