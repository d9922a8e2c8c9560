//! The nodes as commands.

use anyhow::Result;
use clap::{Args, Subcommand};
use std::process::ExitCode;
use wm_nodes::{decoder, encoder, monitor, planner, player, predictor, recorder};
use wm_ros::NodeArgs;

/// A node.
#[derive(Debug, Subcommand)]
pub enum NodeCommand {
    /// Node: camera frames to latents
    Encoder(NodeArguments),
    /// Node: latents and actions to predicted latents
    Predictor(NodeArguments),
    /// Node: predicted latents to pictures
    Decoder(NodeArguments),
    /// Node: actions that bring the camera to a goal image
    Planner(NodeArguments),
    /// Node: a bag's messages at their times
    Player(NodeArguments),
    /// Node: topics into a bag
    Recorder(NodeArguments),
    /// Node: a live line, and at the end how well the predictions came true
    Monitor(NodeArguments),
}

/// What a node takes before `--ros-args`.
#[derive(Args, Debug)]
pub struct NodeArguments {
    /// The node's own arguments, for example --interface lo
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

impl NodeCommand {
    /// The nodes' names.
    pub const NAMES: [&str; 7] = [
        "encoder",
        "predictor",
        "decoder",
        "planner",
        "player",
        "recorder",
        "monitor",
    ];

    /// Runs the node until a signal, or its end.
    pub fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let args = |own: NodeArguments| NodeArgs::parse(own.arguments.into_iter().chain(ros_args));
        let done = |()| ExitCode::SUCCESS;
        match self {
            Self::Encoder(own) => encoder::run(&args(own)?).map(done),
            Self::Predictor(own) => predictor::run(&args(own)?).map(done),
            Self::Decoder(own) => decoder::run(&args(own)?).map(done),
            Self::Planner(own) => planner::run(&args(own)?).map(done),
            Self::Player(own) => player::run(&args(own)?).map(ExitCode::from),
            Self::Recorder(own) => recorder::run(&args(own)?).map(ExitCode::from),
            Self::Monitor(own) => monitor::run(&args(own)?).map(done),
        }
    }
}
