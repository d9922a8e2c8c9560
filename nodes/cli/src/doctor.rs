//! `wm doctor`.

use crate::output::print;
use anyhow::Result;
use clap::Args;
use std::convert::Infallible;
use std::process::ExitCode;
use std::time::Duration;
use wm_doctor::{DoctorError, Level, Machine, ModelFacts, Report, Survey};
use wm_program::progress::Progress;
use wm_ros::{Environment, NodeArgs};

/// Examines machine, network, cameras, actions and model.
#[derive(Args, Debug)]
#[command(
    after_help = "It checks processor, memory, ROS domain and interfaces, receive buffers and clock; cameras and actions with\n\
    their rates, stamps and pictures; and whether the model fits them. Each finding suggests a fix.\n\n\
    Exit codes: 0 no error was found, 1 an error was found, 2 wrong usage."
)]
pub(crate) struct DoctorCommand {
    #[command(flatten)]
    pub listening: Listening,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Options of the commands that listen to the graph.
#[derive(Args, Debug)]
pub(crate) struct Listening {
    /// Image topic of the camera; without it, the default or the first that sends pictures
    #[arg(long, value_name = "TOPIC", value_parser = parse_camera)]
    pub camera: Option<String>,
    /// Topic of the actions
    #[arg(long, value_name = "TOPIC", alias = "action-topic")]
    pub action: Option<String>,
    /// A model folder, or `tiny`, as for the parameter `model` of a node
    #[arg(long, value_name = "DIR", default_value = "tiny")]
    pub model: String,
    /// How long to listen
    #[arg(long, value_name = "S", default_value_t = 6.0, value_parser = parse_seconds)]
    seconds: f64,
    /// Network interface, by name or address; without it, this host only
    #[arg(long, value_name = "INTERFACE")]
    interface: Option<String>,
}

/// A camera has an image topic and its sibling `/compressed`; either name is accepted.
fn parse_camera(text: &str) -> Result<String, Infallible> {
    Ok(text.strip_suffix("/compressed").unwrap_or(text).to_owned())
}

/// Long enough for discovery; short enough for bounded memory.
fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (1.0..=600.0).contains(&seconds) => Ok(seconds),
        _ => Err("expected seconds, from 1 to 600".to_owned()),
    }
}

impl Listening {
    /// The topics that the user named.
    pub(crate) fn topics(&self) -> (Option<&str>, Option<&str>) {
        (self.camera.as_deref(), self.action.as_deref())
    }

    fn args(&self) -> Result<NodeArgs> {
        let interface = self
            .interface
            .iter()
            .flat_map(|name| ["--interface", name.as_str()]);
        Ok(NodeArgs::parse(interface)?)
    }

    /// Reads the machine's facts, and listens to the graph.
    pub(crate) fn listen(&self) -> Result<(Machine, Survey)> {
        let args = self.args()?;
        let environment = Environment::from_env(&args).map_err(DoctorError::from)?;
        let machine = Machine::look(&environment)?;
        let domain = environment.domain_id;
        eprintln!("wm: listening for {} s in domain {domain}", self.seconds);
        let survey = wm_doctor::listen(&args, Duration::from_secs_f64(self.seconds))?;
        Ok((machine, survey))
    }

    /// Runs the model on the camera's pictures.
    pub(crate) fn examine_model(&self, survey: &Survey) -> Result<ModelFacts, DoctorError> {
        let _progress = Progress::open_ended("running the model", "parts");
        let camera = survey.camera(self.camera.as_deref());
        let pictures = camera
            .into_iter()
            .flat_map(|(_, camera)| camera.pictures.iter().flatten());
        wm_doctor::examine_model(&self.model, &pictures.collect::<Vec<_>>())
    }
}

impl DoctorCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let (machine, survey) = self.listening.listen()?;
        let model = self.listening.examine_model(&survey);
        // the chain of causes, as for other errors of this program
        let model = model.map_err(|error| format!("{:#}", anyhow::Error::from(error)));
        let model = model.as_ref().map_err(Clone::clone);
        let report = Report::of(&machine, &survey, Some(model), self.listening.topics());
        match self.json {
            true => print(format_args!("{:#}\n", report.json(&survey)))?,
            false => print(&report)?,
        }
        Ok(ExitCode::from(u8::from(report.worst() == Level::Error)))
    }
}
