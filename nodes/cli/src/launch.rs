//! `wm launch`.

use crate::output::print;
use anyhow::{Context as _, Result};
use clap::Args;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wm_bag_nodes::player;
use wm_launch::{
    LaunchError, Plan, System,
    plan::{Process, Program},
    runner,
};
use wm_model::trained_folder::EMBEDDED;
use wm_ros::NodeArgs;
use wm_zoo::ModelFolder;

/// Starts the nodes of a launch file.
#[derive(Args, Debug)]
pub struct LaunchCommand {
    /// Launch file in ROS 2's YAML launch format
    file: PathBuf,
    /// Launch arguments
    #[arg(value_name = "NAME:=VALUE", value_parser = parse_argument)]
    arguments: Vec<(String, String)>,
    /// Show the arguments of the launch file
    #[arg(short = 's', long)]
    show_args: bool,
    /// Show the command lines that would be run
    #[arg(short = 'p', long, conflicts_with = "show_args")]
    print_description: bool,
}

fn parse_argument(text: &str) -> Result<(String, String), String> {
    match text.split_once(":=") {
        Some((name, value)) if !name.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("expected name:=value".to_owned()),
    }
}

impl LaunchCommand {
    /// Runs it.
    pub fn run(self) -> Result<ExitCode> {
        let file = wm_launch::read(&self.file, &System)?;
        if self.show_args {
            print(wm_launch::describe_arguments(&file))?;
            return Ok(ExitCode::SUCCESS);
        }
        let mut arguments = BTreeMap::new();
        for (name, value) in self.arguments {
            if let Some(first) = arguments.insert(name.clone(), value) {
                return Err(LaunchError::RepeatedArgument { name, first }.into());
            }
        }
        let plan = Plan::resolve(&file, &arguments, &System)?;
        if self.print_description {
            print(describe(&plan)?)?;
            return Ok(ExitCode::SUCCESS);
        }
        check_bags(&plan)?;
        check_models(&plan)?;
        // one thread: the kernel ties the processes' fate to the thread that started them
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        let outcome = runtime.block_on(runner::run(plan)).context("the launch")?;
        Ok(ExitCode::from(outcome.exit_code()))
    }
}

/// That the players of a plan find their bags is known before anything starts. One that is started again may wait for its
/// bag.
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

/// Whether the models of a plan's nodes are there is known before anything starts: a node that is started again and again
/// would only repeat that its model is not.
fn check_models(plan: &Plan) -> Result<()> {
    let is_own = |process: &&Process| process.program == Program::Own;
    for process in plan.processes.iter().filter(is_own) {
        let Some((name, _)) = process.arguments.split_first() else {
            continue;
        };
        if name != "run" && !wm_model_nodes::NODES.iter().any(|node| node.name == name) {
            continue;
        }
        let args = NodeArgs::parse(&process.arguments)?;
        let nodes = args.rest().iter().filter_map(|word| {
            let mut nodes = wm_model_nodes::NODES.iter();
            nodes.find(|node| node.name == word)
        });
        for node in nodes {
            let given: Option<String> = args.given(node.name, wm_ros::NAMESPACE, "model")?;
            let Some(model) = given.filter(|model| model != EMBEDDED) else {
                continue;
            };
            let folder = process.working_directory.as_deref();
            let model = folder.unwrap_or(Path::new("")).join(model);
            ModelFolder::require(&model.to_string_lossy())
                .with_context(|| format!("{} has no model", process.name))?;
        }
    }
    Ok(())
}

/// The command lines of a plan, as a shell would take them.
fn describe(plan: &Plan) -> Result<String> {
    let mut text = String::new();
    for process in &plan.processes {
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

/// A word as a shell takes it.
pub fn quote(word: &str) -> String {
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

    #[test]
    fn launch_arguments_need_a_name() {
        assert_eq!(
            parse_argument("a:=b:=c"),
            Ok(("a".to_owned(), "b:=c".to_owned()))
        );
        assert!(parse_argument(":=b").is_err());
        assert!(parse_argument("a=b").is_err());
    }
}
