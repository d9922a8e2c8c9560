//! `wm init`.

use crate::{doctor::Listening, launch::quote, output::print};
use anyhow::Result;
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wm_doctor::Setup;

/// Writes a launch file and parameter files for the camera and the arm that are found.
#[derive(Args, Debug)]
#[command(
    after_help = "The folder gets live.launch.yaml, whose defaults are the topics found, and config/ with the nodes'\n\
    parameter files. For an arm that publishes velocities, poses or tf, name that topic with --action: the launch then\n\
    starts the action adapter too. Existing files are never overwritten.\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, also where --camera or --action has to choose."
)]
pub(crate) struct InitCommand {
    /// Folder for the files; made if it does not exist
    folder: PathBuf,
    #[command(flatten)]
    listening: Listening,
}

impl InitCommand {
    pub(crate) fn run(mut self) -> Result<ExitCode> {
        // the launch may start in another folder
        if Path::new(&self.listening.model).exists() {
            let path = std::path::absolute(&self.listening.model)?;
            self.listening.model = path.to_string_lossy().into_owned();
        }
        let (_, survey) = self.listening.listen()?;
        let model = self.listening.examine_model(&survey)?;
        let setup = Setup::new(&survey, &model, self.listening.topics())?;
        let paths = setup.write(&self.folder)?;
        for path in &paths {
            print(format_args!("{}\n", path.display()))?;
        }
        let camera = &setup.camera;
        let not_found = match survey.camera(Some(camera)) {
            Some(_) => "",
            None => " (NOT found: it has no publisher)",
        };
        let adapted = match setup.adapter {
            Some(source) => {
                format!(" (converted to actions by the action adapter, source {source})")
            }
            None => String::new(),
        };
        print(format_args!(
            "camera {camera}{not_found}, actions {}{adapted}, model {}\n",
            setup.action, setup.model
        ))?;
        if let Some(period_s) = setup.frame_period_s {
            print(format_args!(
                "frame_period is {period_s:.3} s, the camera's: it is slower than the model was trained at\n"
            ))?;
        }
        if let Some(launch) = paths.first() {
            print(format_args!(
                "start with: wm launch {}\n",
                quote(&launch.to_string_lossy())
            ))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}
