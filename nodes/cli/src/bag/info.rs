//! `wm bag info`.

use crate::{external, output::print};
use anyhow::{Context as _, Result, ensure};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use wm_audit::{JUDGES_VIDEO, Topics, audit_bag, video_topics};
use wm_bag::{BagReader, BagWarning};
use wm_camera::transport::Transport;
use wm_program::progress::Progress;
use wm_robot_nodes::ending::Ending;

/// The program that decodes video.
const DECODER: &str = "wm-datasets";

/// Shows the contents of a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "--audit decodes every picture: it reports repeated and frozen frames with the true rate of the camera, missing\n\
    frames, unusable stamps, the lag between pictures, actions and state, actions against the change of the\n\
    state, idle time, outliers and sizes that change. Each finding suggests a fix (docs/bags.md). Pictures of h264\n\
    topics are examined by the program wm-datasets; without it, they are listed.\n\n\
    Exit codes: 0 done, also with findings; 1 failed; 2 wrong usage; 3 the bag has lost messages."
)]
pub(crate) struct InfoCommand {
    /// Folder of the bag, or one of its files
    bag: PathBuf,
    /// Examine pictures, stamps, actions and state too
    #[arg(long)]
    audit: bool,
    /// Topic of a camera to examine, the one that actions are compared with first (repeatable) [default: all, and
    /// /camera/image_raw first]
    #[arg(long = "camera", value_name = "TOPIC", requires = "audit")]
    cameras: Vec<String>,
    /// Topic of the actions [default: /wm/action, or the only one]
    #[arg(long, value_name = "TOPIC", alias = "action-topic", requires = "audit")]
    action: Option<String>,
    /// Print the audit as JSON, and nothing else
    #[arg(long, requires = "audit")]
    json: bool,
}

impl InfoCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let reader = BagReader::open(&self.bag)?;
        let summary = reader.summary();
        if !self.json {
            print(format_args!("{summary}\n"))?;
            for topic in &summary.topics {
                let transport = Transport::of(&topic.name, &topic.type_name);
                let video = transport.filter(|transport| *transport == Transport::Video);
                if let Some(advice) = video.and_then(|video| video.advice(&topic.name)) {
                    print(format_args!("Note: {advice}\n"))?;
                }
            }
        }
        let has_undecoded = !JUDGES_VIDEO && !video_topics(&reader).is_empty();
        let other = external::program(DECODER)?.filter(|_| self.audit && has_undecoded);
        if let Some(program) = other {
            self.audit_by(&program)?;
        } else if self.audit {
            let topics = Topics {
                cameras: self.cameras,
                actions: self.action,
            };
            let progress = Progress::open_ended("examining", "messages");
            let audit = audit_bag(&reader, &topics, || progress.inc(1));
            drop(progress);
            match self.json {
                true => print(format_args!("{:#}\n", serde_json::to_value(&audit)?))?,
                false => print(format_args!("\n{audit}\n"))?,
            }
        }
        let is_lost = summary.warnings.iter().any(BagWarning::is_loss);
        Ok(Ending::lost_if(is_lost).into())
    }

    /// Runs the program with a video decoder, which prints the audit.
    fn audit_by(&self, program: &Path) -> Result<()> {
        let mut command = Command::new(program);
        command.arg("audit");
        for camera in &self.cameras {
            command.args(["--camera", camera]);
        }
        if let Some(action) = &self.action {
            command.args(["--action", action]);
        }
        if self.json {
            command.arg("--json");
        }
        let status = command.arg("--").arg(&self.bag).status();
        let status = status.with_context(|| format!("starting {}", program.display()))?;
        ensure!(status.success(), "{} failed: {status}", program.display());
        Ok(())
    }
}
