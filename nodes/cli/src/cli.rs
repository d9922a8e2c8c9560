//! The command line.

use crate::{
    bag, completions, doctor, external, init, keys, launch, man, model, node, report, view,
    zenoh_router,
};
use clap::{CommandFactory as _, Parser, Subcommand};
use std::path::Path;
use std::process::ExitCode;
use wm_doctor::{DoctorError, SetupError};
use wm_launch::LaunchError;
use wm_ros::ArgsError;

/// The arguments for ROS follow it.
const ROS_ARGS: &str = "--ros-args";

/// ROS 2 nodes that predict what a camera will see next, given a robot's actions, and that plan actions.
#[derive(Debug, Parser)]
#[command(name = "wm", version, propagate_version = true)]
#[command(
    after_help = "Nodes and `bag play|record` take ROS arguments: --ros-args -r from:=to -p name:=value \
    --params-file FILE -r __ns:=/x -r __node:=name --log-level LEVEL.\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 finished with data lost."
)]
struct Cli {
    #[command(subcommand)]
    command: Subcommands,
}

#[derive(Debug, Subcommand)]
enum Subcommands {
    /// Start the nodes of a ROS 2 YAML launch file and stop them together
    Launch(launch::LaunchCommand),
    /// Check machine, network, cameras, actions and model, and suggest fixes
    Doctor(doctor::DoctorCommand),
    /// Write a launch file and parameter files for the camera and the arm that are found
    Init(init::InitCommand),
    /// Play, record, inspect, recover, cut, import and export bags
    #[command(subcommand)]
    Bag(Box<bag::BagCommand>),
    /// Make bags with a simulated arm on a tabletop (runs wm-training); --live: the node sim_arm
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Sim(external::Arguments),
    /// Prepare bags for training, or show prepared data (runs wm-training)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Dataset(external::Arguments),
    /// Train models from bags (runs wm-training)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Train(external::Arguments),
    /// Evaluate models on held-out bags (runs wm-training)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Eval(external::Arguments),
    /// Check, convert, download and run published models
    #[command(subcommand)]
    Model(model::ModelCommand),
    /// Score a recorded bag: compare its predictions with its frames
    Report(report::ReportCommand),
    /// Serve a live page of camera, predictions and plans, or of a bag (node)
    View(Box<view::ViewCommand>),
    /// Carry topics and services to other machines over Zenoh (runs wm-bridge)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    Bridge(external::Arguments),
    /// Run the Zenoh router of this host, through which programs with the middleware zenoh find each other
    ZenohRouter(zenoh_router::ZenohRouterCommand),
    /// Cost candidates for planners on other machines (runs wm-planner-worker)
    #[command(disable_help_flag = true, disable_version_flag = true)]
    PlannerWorker(external::Arguments),
    /// Make keys, certificates and access rules for a Zenoh network with TLS
    Keys(Box<keys::KeysCommand>),
    /// Print a completion script for bash, zsh or fish
    Completions(completions::CompletionsCommand),
    /// Write the man pages
    Man(man::ManCommand),
    #[command(flatten)]
    Node(node::NodeCommand),
}

/// The command line, for completions and man pages.
pub(crate) fn definition() -> clap::Command {
    Cli::command()
}

/// A command with its arguments for ROS.
pub(crate) struct Command {
    command: Subcommands,
    ros_args: Vec<String>,
}

/// Parses the command line. On wrong usage, prints an error and ends the process with exit code 2.
///
/// A program that is called by a node's name, for example by a link `lib/wm_nodes/encoder`, is that node.
pub(crate) fn parse() -> Command {
    let mut arguments: Vec<String> = std::env::args_os()
        .map(|argument| argument.to_string_lossy().into_owned())
        .collect();
    let called = arguments
        .first()
        .and_then(|path| Path::new(path).file_name())
        .map(|name| name.to_string_lossy());
    if let Some(name) = called.filter(|name| node::is_node(name)) {
        let name = name.into_owned();
        arguments.splice(..1, ["wm".to_owned(), name]);
    }
    let at = arguments
        .iter()
        .position(|argument| argument == ROS_ARGS)
        .unwrap_or(arguments.len());
    let ros_args = arguments.split_off(at);
    let arguments = live(arguments);
    let command = Cli::parse_from(arguments).command;
    if !ros_args.is_empty() && !command.takes_ros_args() {
        let error = clap::Error::raw(
            clap::error::ErrorKind::UnknownArgument,
            format!("this command takes no {ROS_ARGS}: it is not a node\n"),
        );
        error.exit();
    }
    Command { command, ros_args }
}

/// `wm sim --live` is the node `sim_arm`, which needs no other program.
fn live(mut arguments: Vec<String>) -> Vec<String> {
    const LIVE: &str = "--live";
    let is_sim = arguments.get(1).is_some_and(|command| command == "sim");
    if is_sim && arguments.iter().any(|argument| argument == LIVE) {
        arguments.retain(|argument| argument != LIVE);
        if let Some(command) = arguments.get_mut(1) {
            wm_robot_nodes::sim_arm::NODE.name.clone_into(command);
        }
    }
    arguments
}

impl Subcommands {
    fn takes_ros_args(&self) -> bool {
        match self {
            Self::Node(command) => command.takes_ros_args(),
            Self::Bridge(_) | Self::Keys(_) => true,
            Self::Bag(command) => command.takes_ros_args(),
            Self::View(command) => command.takes_ros_args(),
            _ => false,
        }
    }
}

impl Command {
    /// Runs the command.
    ///
    /// # Errors
    /// The failure, for the user.
    pub(crate) fn run(self) -> anyhow::Result<ExitCode> {
        match self.command {
            Subcommands::Launch(command) => command.run(),
            Subcommands::Doctor(command) => command.run(),
            Subcommands::Init(command) => command.run(),
            Subcommands::Bag(command) => command.run(self.ros_args),
            Subcommands::Sim(own) => own.exec("wm-training", ["sim"], Vec::new()),
            Subcommands::Dataset(own) => own.exec("wm-training", ["dataset"], Vec::new()),
            Subcommands::Train(own) => own.exec("wm-training", ["train"], Vec::new()),
            Subcommands::Eval(own) => own.exec("wm-training", ["eval"], Vec::new()),
            Subcommands::Model(command) => command.run(),
            Subcommands::Report(command) => command.run(),
            Subcommands::View(command) => command.run(self.ros_args),
            Subcommands::Bridge(own) => own.exec("wm-bridge", [], self.ros_args),
            Subcommands::ZenohRouter(command) => command.run(),
            Subcommands::PlannerWorker(own) => own.exec("wm-planner-worker", [], Vec::new()),
            Subcommands::Keys(command) => command.run(self.ros_args),
            Subcommands::Completions(command) => done(command.run(definition())),
            Subcommands::Man(command) => done(command.run(definition())),
            Subcommands::Node(command) => command.run(self.ros_args),
        }
    }
}

fn done(result: anyhow::Result<()>) -> anyhow::Result<ExitCode> {
    result.map(|()| ExitCode::SUCCESS)
}

/// 2 if the user's arguments are wrong, a node's parameters included; otherwise 1.
pub(crate) fn failure_code(error: &anyhow::Error) -> ExitCode {
    let is_usage = error.is::<ArgsError>()
        || error.downcast_ref().is_some_and(wm_ros::Error::is_usage)
        || error.downcast_ref().is_some_and(DoctorError::is_usage)
        || error.downcast_ref().is_some_and(SetupError::is_usage)
        || error.downcast_ref().is_some_and(LaunchError::is_usage);
    ExitCode::from(if is_usage { 2 } else { 1 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn live_simulation_is_a_node() {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(live(words("wm sim --live")), words("wm sim_arm"));
        for other in ["wm sim --out DIR", "wm", "wm nodes --live"] {
            assert_eq!(live(words(other)), words(other));
        }
    }

    /// New parameters become flags automatically; the bag to play is a positional argument.
    #[test]
    fn every_parameter_of_player_and_recorder_is_a_flag() {
        for (command, node) in [("play", "player"), ("record", "recorder")] {
            let cli = Cli::command();
            let bag = cli.find_subcommand("bag").unwrap();
            let command = bag.find_subcommand(command).unwrap();
            let node = node::definitions()
                .find(|definition| definition.name == node)
                .unwrap();
            for spec in (node.parameters)().iter().filter(|spec| spec.name != "bag") {
                let flag = command
                    .get_arguments()
                    .find(|argument| argument.get_id().as_str() == spec.name);
                let long = flag.and_then(clap::Arg::get_long);
                assert_eq!(long, Some(spec.name.replace('_', "-").as_str()));
            }
        }
    }

    #[test]
    fn every_node_is_a_subcommand() {
        for node in node::definitions() {
            let name = node.name;
            assert!(Cli::command().find_subcommand(name).is_some(), "{name}");
        }
    }
}
