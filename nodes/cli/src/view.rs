//! `wm view`.

use crate::{
    output::print,
    parameter_flags::{Flagged, ParameterFlags},
    parameters::Parameters,
};
use anyhow::Result;
use clap::{Arg, Args};
use std::path::PathBuf;
use std::process::ExitCode;
use wm_ros::{NodeArgs, ParameterSpec};
use wm_view::NODE;

/// Serves the page.
#[derive(Args, Debug)]
#[command(after_help = NODE.help())]
pub(crate) struct ViewCommand {
    /// Bag to show, its folder or a single .mcap file; without one, the live topics
    bag: Option<PathBuf>,
    #[command(flatten)]
    flags: ParameterFlags<View>,
    /// Network interface or address of the node, for example lo
    #[arg(long)]
    interface: Option<String>,
    /// Log level: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
    /// Print an annotated parameter file with the defaults, and exit
    #[arg(long)]
    print_params: bool,
}

/// The node's parameters as flags.
struct View;

impl Flagged for View {
    fn specs() -> Vec<ParameterSpec> {
        (NODE.parameters)()
    }

    fn flag(name: &str, flag: Arg) -> Option<Arg> {
        match name {
            // lists of numbers belong in parameter files
            "bag" | "axes" => None,
            "foxglove_rates" => Some(flag.value_name("REGEX=HZ")),
            "foxglove_origins" => Some(flag.value_name("ORIGIN")),
            _ => Some(flag),
        }
    }
}

impl ViewCommand {
    /// Whether `--ros-args` may follow.
    pub(crate) fn takes_ros_args(&self) -> bool {
        !self.print_params
    }

    /// Serves the page until a signal.
    pub(crate) fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        if self.print_params {
            print(NODE.params_file())?;
            return Ok(ExitCode::SUCCESS);
        }
        let mut parameters = Parameters::new();
        parameters.set_some("bag", self.bag)?;
        self.flags.parameters(&mut parameters)?;
        parameters.log_level(self.log_level);
        let interface = self.interface.map(|name| ["--interface".to_owned(), name]);
        let words = interface.into_iter().flatten();
        (NODE.run)(&NodeArgs::parse(words.chain(parameters.with(ros_args)))?)
    }
}
