//! The nodes as commands.

use anyhow::Result;
use clap::{Args, Subcommand};
use std::process::ExitCode;
use wm_bag_nodes::{player, recorder};
use wm_model_nodes::{decoder, encoder, env, evaluator, planner, predictor};
use wm_report::monitor;
use wm_ros::{Component, NodeArgs};

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
    /// Node: what each of a policy's candidate chunks would do
    Evaluator(NodeArguments),
    /// Node: the world model as the environment of a policy
    Env(NodeArguments),
    /// Node: a bag's messages at their times
    Player(NodeArguments),
    /// Node: topics into a bag
    Recorder(NodeArguments),
    /// Nodes of one process: encoder, predictor, decoder, planner, or some of them
    #[command(name = "run")]
    Together(TogetherArguments),
    /// Node: a live line, and at the end how well the predictions came true
    Monitor(NodeArguments),
}

/// What a node takes before `--ros-args`.
#[derive(Args, Debug)]
pub struct NodeArguments {
    /// The node's own arguments, for example --interface lo; its parameters (`--ros-args -p NAME:=VALUE`) are in
    /// launch-configs/config, and one that is not known gets the list of all
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// What several nodes take before `--ros-args`.
#[derive(Args, Debug)]
pub struct TogetherArguments {
    /// The nodes: encoder, predictor, decoder, planner, evaluator; and --interface
    #[arg(required = true, trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// The node of this name, for a process with others; ends the process where there is none.
fn component(name: &str) -> Component<anyhow::Error> {
    match name {
        encoder::NAME => Component::new(encoder::NAME, encoder::body),
        predictor::NAME => Component::new(predictor::NAME, predictor::body),
        decoder::NAME => Component::new(decoder::NAME, decoder::body),
        planner::NAME => Component::new(planner::NAME, planner::body),
        evaluator::NAME => Component::new(evaluator::NAME, evaluator::body),
        other => {
            let kind = clap::error::ErrorKind::InvalidValue;
            let message = format!(
                "`{other}` is none of encoder, predictor, decoder, planner and evaluator\n"
            );
            clap::Error::raw(kind, message).exit()
        }
    }
}

fn run_together(args: &NodeArgs) -> Result<()> {
    let components = args.rest().iter().map(|name| component(name)).collect();
    wm_ros::run_together(wm_ros::NAMESPACE, args, components)
}

impl NodeCommand {
    /// The nodes' names.
    pub const NAMES: [&str; 9] = [
        "encoder",
        "predictor",
        "decoder",
        "planner",
        "evaluator",
        "env",
        "player",
        "recorder",
        "monitor",
    ];

    /// Runs the node until a signal, or its end.
    pub fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let args = |own: Vec<String>| NodeArgs::parse(own.into_iter().chain(ros_args));
        let done = |()| ExitCode::SUCCESS;
        match self {
            Self::Encoder(own) => encoder::run(&args(own.arguments)?).map(done),
            Self::Predictor(own) => predictor::run(&args(own.arguments)?).map(done),
            Self::Decoder(own) => decoder::run(&args(own.arguments)?).map(done),
            Self::Planner(own) => planner::run(&args(own.arguments)?).map(done),
            Self::Evaluator(own) => evaluator::run(&args(own.arguments)?).map(done),
            Self::Env(own) => env::run(&args(own.arguments)?).map(done),
            Self::Player(own) => player::run(&args(own.arguments)?).map(ExitCode::from),
            Self::Recorder(own) => recorder::run(&args(own.arguments)?).map(ExitCode::from),
            Self::Together(own) => run_together(&args(own.arguments)?).map(done),
            Self::Monitor(own) => monitor::run(&args(own.arguments)?).map(done),
        }
    }
}
