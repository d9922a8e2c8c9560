//! `wm-training`: `wm sim`, `wm dataset`, `wm train`, `wm eval` and `wm model calibrate`, as a separate program, since a robot
//! needs none of them.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 130 a training stopped by a signal and saved.

use std::{ffi::OsString, io::IsTerminal as _, process::ExitCode};

use clap::{Parser, Subcommand};
use tracing_subscriber::EnvFilter;
use wm_dataset::DatasetArgs;
use wm_evaluation::{
    CalibrateArgs, ClosedLoopArgs, ImaginedArgs, MergeArgs, PaperArgs, Protocol, Settings,
    SuiteArgs,
};
use wm_metrics::findings::Suite;
use wm_sim::SimArgs;
use wm_training::{
    adapter::TrainAdapterArgs,
    autoencoder::{EvaluateAutoencoderArgs, TrainAutoencoderArgs},
    distance::TrainDistanceArgs,
    distill::TrainDistillArgs,
    encoder::TrainEncoderArgs,
    idm::{EvaluateIdmArgs, TrainIdmArgs},
    model::TrainModelArgs,
    model_card,
    probe::{EvaluateProbeArgs, TrainProbeArgs},
    round::TrainRoundArgs,
    run::{RunEnd, Stop},
    stopped,
    subgoals::TrainSubgoalsArgs,
    transition::{EvaluateTransitionArgs, TrainTransitionArgs, TrainWorkerArgs},
};

/// Exit code after a signal, as in a shell.
const STOPPED: u8 = 130;

/// Makes bags, trains models on them and evaluates the models.
#[derive(Debug, Parser)]
#[command(
    name = "wm-training",
    bin_name = "wm",
    version,
    propagate_version = true
)]
enum Command {
    /// Make bags with a simulated arm on a tabletop
    Sim(SimArgs),
    /// Prepare bags for training, or show prepared data
    Dataset(Box<DatasetArgs>),
    /// Train models from bags
    #[command(subcommand)]
    Train(Box<TrainCommand>),
    /// Evaluate models on held-out bags
    #[command(subcommand)]
    Eval(Box<EvalCommand>),
    /// Commands of `wm model` that read bags
    #[command(subcommand)]
    Model(Box<ModelCommand>),
}

#[derive(Debug, Subcommand)]
enum ModelCommand {
    /// Calibrate a model's int8 input ranges on bags
    Calibrate(CalibrateArgs),
}

#[derive(Debug, Subcommand)]
enum TrainCommand {
    /// Train autoencoder, transition model, inverse dynamics model and success probe in sequence into one folder
    Model(TrainModelArgs),
    /// Train the autoencoder: frames to latents and back
    Autoencoder(TrainAutoencoderArgs),
    /// Train a small semantic encoder, whose features encode actions
    Encoder(TrainEncoderArgs),
    /// Train the transition model on the latents of a frozen encoder
    Transition(TrainTransitionArgs),
    /// Compute a share of each step of `wm train transition --listen`, on this machine or another
    Worker(TrainWorkerArgs),
    /// Train the S-VAE adapter and its pixel decoder on the features of a frozen encoder
    Adapter(TrainAdapterArgs),
    /// Train a student that samples in one or two steps like a transition model, its teacher, in ten
    Distill(TrainDistillArgs),
    /// Train the inverse dynamics model on the latents of a frozen encoder
    Idm(TrainIdmArgs),
    /// Train the success probe on the latents of a frozen encoder
    Probe(TrainProbeArgs),
    /// Train the model of subgoals, which proposes latents between the present one and a goal
    Subgoals(TrainSubgoalsArgs),
    /// Train the distance between latents, in model steps
    Distance(TrainDistanceArgs),
    /// Train a new model from the present one on recordings, and test both on the newest: a round of the node learner
    Round(TrainRoundArgs),
}

#[derive(Debug, Subcommand)]
enum EvalCommand {
    /// Measure how well an autoencoder reconstructs frames
    Autoencoder(EvaluateAutoencoderArgs),
    /// Compare a transition model's predictions with the persistence baseline, and measure plans made with it
    Transition(EvaluateTransitionArgs),
    /// Measure how well an inverse dynamics model infers actions, from real and from predicted latents
    Idm(EvaluateIdmArgs),
    /// Measure how well a success probe separates success from failure
    Probe(EvaluateProbeArgs),
    /// Measure a model by all suites
    All(SuiteArgs),
    /// Compare decoded rollouts with the true frames
    Fidelity(SuiteArgs),
    /// Measure whether predictions obey actions; with --task, the success rate of a planner on the simulated arm
    Control(SuiteArgs),
    /// Measure the success rate of a planner on the simulated arm; same as control --task
    Task(ClosedLoopArgs),
    /// Measure whether latents encode actions and success
    Latents(SuiteArgs),
    /// Measure how a policy performs in the imagined environment
    Policy(SuiteArgs),
    /// Measure whether success in imagination ranks policies as success on the simulated arm does
    Imagined(ImaginedArgs),
    /// Measure predictions under other light, camera faults and wrong rates
    Robustness(SuiteArgs),
    /// Measure a model's computation on this machine
    Cost(SuiteArgs),
    /// Fill the paper's tables and figures with the values of models on bags
    Paper(Box<PaperArgs>),
    /// Merge the records of shards, or of several models
    Merge(MergeArgs),
    /// Print the settings of a protocol as YAML, for --settings
    Settings {
        /// Extent of the measurement
        #[arg(long, value_enum, default_value_t)]
        protocol: Protocol,
    },
}

impl TrainCommand {
    fn run(self) -> anyhow::Result<ExitCode> {
        let then = match self {
            Self::Worker(_) => "leaves the training",
            _ => "finishes the step, saves, and writes the model as it is",
        };
        let stop = Stop::on_signals(then)?;
        let (ended, of) = match self {
            // It prints its own card and summary, for all parts.
            Self::Model(arguments) => (arguments.run(&stop)?, None),
            Self::Round(arguments) => (arguments.run(&stop)?, None),
            // The training writes the model.
            Self::Worker(arguments) => (arguments.run(&stop)?, None),
            Self::Autoencoder(arguments) => (
                arguments.run(&stop)?,
                Some((arguments.on.run, "autoencoder")),
            ),
            Self::Encoder(arguments) => {
                (arguments.run(&stop)?, Some((arguments.on.run, "encoder")))
            }
            Self::Transition(arguments) => (
                arguments.run(&stop)?,
                Some((arguments.on.run, "transition")),
            ),
            Self::Adapter(arguments) => (arguments.run(&stop)?, Some((arguments.run, "adapter"))),
            Self::Distill(arguments) => (arguments.run(&stop)?, Some((arguments.run, "distill"))),
            Self::Idm(arguments) => (arguments.run(&stop)?, Some((arguments.on.run, "idm"))),
            Self::Probe(arguments) => (arguments.run(&stop)?, Some((arguments.on.run, "probe"))),
            Self::Subgoals(arguments) => {
                (arguments.run(&stop)?, Some((arguments.on.run, "subgoals")))
            }
            Self::Distance(arguments) => {
                (arguments.run(&stop)?, Some((arguments.on.run, "distance")))
            }
        };
        match (ended, of) {
            (RunEnd::Finished, Some((run, _))) => model_card::write(&run),
            (RunEnd::Stopped, Some((run, part))) => {
                println!("{}", stopped::summary(&run.out, &[part])?);
            }
            (_, None) => {}
        }
        Ok(match ended {
            RunEnd::Finished => ExitCode::SUCCESS,
            RunEnd::Stopped => ExitCode::from(STOPPED),
        })
    }
}

impl Command {
    fn run(self) -> anyhow::Result<ExitCode> {
        match self {
            Self::Sim(arguments) => arguments.run()?,
            Self::Dataset(arguments) => arguments.run()?,
            Self::Train(command) => return command.run(),
            Self::Model(command) => match *command {
                ModelCommand::Calibrate(arguments) => arguments.run()?,
            },
            Self::Eval(command) => match *command {
                EvalCommand::Autoencoder(arguments) => arguments.run()?,
                EvalCommand::Transition(arguments) => arguments.run()?,
                EvalCommand::Idm(arguments) => arguments.run()?,
                EvalCommand::Probe(arguments) => arguments.run()?,
                EvalCommand::All(arguments) => arguments.run(&Suite::ALL)?,
                EvalCommand::Fidelity(arguments) => arguments.run(&[Suite::Fidelity])?,
                EvalCommand::Control(arguments) => arguments.run(&[Suite::Control])?,
                EvalCommand::Task(arguments) => arguments.run()?,
                EvalCommand::Latents(arguments) => arguments.run(&[Suite::Latents])?,
                EvalCommand::Policy(arguments) => arguments.run(&[Suite::Policy])?,
                EvalCommand::Imagined(arguments) => arguments.run()?,
                EvalCommand::Robustness(arguments) => arguments.run(&[Suite::Robustness])?,
                EvalCommand::Paper(arguments) => arguments.run()?,
                EvalCommand::Cost(arguments) => arguments.run(&[Suite::Cost])?,
                EvalCommand::Merge(arguments) => arguments.run()?,
                EvalCommand::Settings { protocol } => {
                    print!("{}", Settings::of(protocol, 0).to_yaml()?);
                }
            },
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// Rewrites `eval control --task` to `eval task --task`, which has other arguments than the suite.
fn with_task(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = arguments.collect();
    let is_task = |argument: &OsString| {
        let text = argument.to_string_lossy();
        text == "--task" || text.starts_with("--task=")
    };
    if let [_, eval, control, rest @ ..] = arguments.as_mut_slice()
        && *eval == "eval"
        && *control == "control"
        && rest.iter().any(is_task)
    {
        *control = "task".into();
    }
    arguments
}

fn main() -> ExitCode {
    if wm_program::command_line::describe_if_requested::<Command>() {
        return ExitCode::SUCCESS;
    }
    wm_program::process::prepare();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .without_time()
        .with_target(false)
        .init();
    if let Some(cache) = wm_zoo::PackedCache::of_environment() {
        cache.use_in_process();
    }
    match Command::parse_from(with_task(std::env::args_os())).run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("wm: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn command_line_is_consistent() {
        Command::command().debug_assert();
    }
}
