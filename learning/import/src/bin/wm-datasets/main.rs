//! `wm-datasets`: imports data sets as bags, exports bags as data sets, and decodes the video in bags. It serves
//! `wm bag import`, `wm bag export`, `wm bag convert --video jpeg` and `wm bag info --audit`. It is a separate program
//! because video codecs and parquet take long to build.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done, but some episodes, parts of bags or messages were skipped.

mod audit;
mod convert;
mod mapping;

use std::{
    io::{IsTerminal as _, Write as _},
    ops::RangeInclusive,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context as _, Result};
use audit::AuditCommand;
use clap::{Args, Parser, Subcommand, ValueEnum};
use convert::ConvertCommand;
use mapping::MappingOptions;
use tracing_subscriber::EnvFilter;
use wm_import::{ImportReport, Shard, import_bridge, import_droid};
use wm_motion::actions::ActionSpace;
use wm_program::progress::Progress;

/// Exit code if some episodes, parts of bags or messages were skipped.
const INCOMPLETE: u8 = 3;

/// Imports data sets as bags, and exports bags as data sets.
#[derive(Debug, Parser)]
#[command(name = "wm-datasets", bin_name = "wm bag", version)]
enum Command {
    /// Convert the episodes of a data set to bags
    #[command(subcommand)]
    Import(ImportCommand),
    /// Convert bags to a data set
    #[command(subcommand)]
    Export(ExportCommand),
    /// Convert a bag and its video topics to pictures
    #[command(hide = true)]
    Convert(ConvertCommand),
    /// Audit a bag with its video topics
    #[command(hide = true)]
    Audit(AuditCommand),
}

#[derive(Debug, Subcommand)]
enum ImportCommand {
    /// Bridge V2 and SOAR: the mp4 and npz layout, or the RLDS TFRecord layout
    Bridge(EpisodesCommand),
    /// DROID: annotation/SPLIT/NAME.json with three videos per episode, or the RLDS TFRecord layout
    Droid(EpisodesCommand),
    /// LeRobot, v2.1 or v3.0
    Lerobot(FromLerobot),
}

#[derive(Debug, Subcommand)]
enum ExportCommand {
    /// LeRobot, v3.0
    Lerobot(ToLerobot),
}

#[derive(Args, Debug)]
struct EpisodesCommand {
    /// Folder of the episodes
    source: PathBuf,
    /// Folder for the bags, one per episode
    output: PathBuf,
    /// Import at most this many episodes
    #[arg(long)]
    episodes: Option<usize>,
    #[command(flatten)]
    common: Common,
}

#[derive(Args, Debug)]
struct FromLerobot {
    /// Folder of the data set (with meta/info.json)
    source: PathBuf,
    /// Folder for the bags, one per episode
    output: PathBuf,
    /// Import only these episodes: FIRST..LAST (with LAST), or one number
    #[arg(long, value_parser = parse_episodes)]
    episodes: Option<RangeInclusive<i64>>,
    /// Action space of the data set: a JSON file with name, rate in Hz and dimensions, like "space" in model.json. The bags
    /// keep it. Without it, Bridge V2's names (dx dy dz droll dpitch dyaw gripper) are recognised; otherwise names and recorded
    /// values decide, and the result is printed and written to OUTPUT/action_space.json
    #[arg(long, value_name = "FILE")]
    action_space: Option<PathBuf>,
    /// Stamps of frames: recorded (column timestamp) or rate (frame_index and fps)
    #[arg(long, value_enum, default_value_t = Stamps::Recorded)]
    stamps: Stamps,
    #[command(flatten)]
    common: Common,
}

/// Source of the stamps of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Stamps {
    Recorded,
    Rate,
}

#[derive(Args, Debug)]
struct Common {
    /// JPEG quality of video frames, 1 to 100
    #[arg(long, default_value_t = wm_import::ImportOptions::default().jpeg_quality, value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg_quality: u8,
    /// Import every Nth episode, from the Ith (counted from 0): run the command on several machines, each with a
    /// different I. Bags keep their numbers, so that all machines may write to one folder
    #[arg(long, value_name = "I/N", default_value = "0/1")]
    shard: Shard,
    /// Continue an interrupted import: whole bags of the same episodes stay as they are. Give the same options
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    mapping: MappingOptions,
}

#[derive(Args, Debug)]
struct ToLerobot {
    /// Folder for the data set
    output: PathBuf,
    /// Bags. A bag is one episode, or several if /task/success or gaps separate them
    #[arg(required = true)]
    bags: Vec<PathBuf>,
    /// Frames per second [default: the rate of /wm/action]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    fps: Option<u32>,
    /// robot_type of the data set
    #[arg(long)]
    robot_type: Option<String>,
    /// Topic of a camera (repeatable) [default: every .../image_raw and .../image_raw/compressed]
    #[arg(long = "camera", value_name = "TOPIC")]
    cameras: Vec<String>,
    /// Task of episodes without /task/instruction
    #[arg(long, default_value = "")]
    task: String,
}

/// Parses `3`, or `0..3` including the last.
fn parse_episodes(text: &str) -> Result<RangeInclusive<i64>, String> {
    let number = |text: &str| {
        text.parse::<i64>()
            .ok()
            .filter(|number| *number >= 0)
            .ok_or_else(|| format!("expected FIRST..LAST or one number, got {text:?}"))
    };
    let (first, last) = text.split_once("..").unwrap_or((text, text));
    let (first, last) = (number(first)?, number(last.trim_start_matches('='))?);
    if first > last {
        return Err(format!(
            "expected FIRST..LAST with FIRST up to LAST, got {text:?}"
        ));
    }
    Ok(first..=last)
}

fn read_action_space(file: &Path) -> Result<ActionSpace> {
    let text = std::fs::read_to_string(file);
    let space = text
        .map_err(anyhow::Error::from)
        .and_then(|text| Ok(serde_json::from_str(&text)?));
    space.with_context(|| format!("action space {}", file.display()))
}

impl EpisodesCommand {
    fn options(&self) -> wm_import::ImportOptions {
        wm_import::ImportOptions {
            episodes: self.episodes,
            jpeg_quality: self.common.jpeg_quality,
            shard: self.common.shard,
            resume: self.common.resume,
            actions: self.common.mapping.mapping(),
            ..wm_import::ImportOptions::default()
        }
    }
}

impl ImportCommand {
    fn run(self) -> Result<ImportReport> {
        let _progress = Progress::open_ended("importing", "episodes");
        Ok(match self {
            Self::Bridge(from) => import_bridge(&from.source, &from.output, &from.options())?,
            Self::Droid(from) => import_droid(&from.source, &from.output, &from.options())?,
            Self::Lerobot(from) => {
                let options = wm_import::lerobot::ImportOptions {
                    episodes: from.episodes,
                    action_space: from
                        .action_space
                        .as_deref()
                        .map(read_action_space)
                        .transpose()?,
                    jpeg_quality: from.common.jpeg_quality,
                    shard: from.common.shard,
                    resume: from.common.resume,
                    actions: from.common.mapping.mapping(),
                    is_nominal: from.stamps == Stamps::Rate,
                    ..wm_import::lerobot::ImportOptions::default()
                };
                wm_import::lerobot::import(&from.source, &from.output, &options)?
            }
        })
    }
}

impl ToLerobot {
    /// Prints the result, and on standard error the differences from the bags.
    fn run(self) -> Result<ExitCode> {
        let options = wm_import::lerobot::ExportOptions {
            fps: self.fps,
            robot_type: self.robot_type,
            cameras: self.cameras,
            task: self.task,
            ..wm_import::lerobot::ExportOptions::default()
        };
        let progress = Progress::open_ended("exporting", "episodes");
        let exported = wm_import::lerobot::export(&self.bags, &self.output, &options)?;
        drop(progress);
        for line in exported.resampled.iter().chain(&exported.split) {
            eprintln!("wm-datasets: {line}");
        }
        for line in &exported.skipped {
            eprintln!("wm-datasets: skipped: {line}");
        }
        writeln!(
            std::io::stdout().lock(),
            "{}: {} episodes, {} frames at {} per second",
            self.output.display(),
            exported.episodes,
            exported.frames,
            exported.fps
        )?;
        Ok(match exported.skipped.is_empty() {
            true => ExitCode::SUCCESS,
            false => ExitCode::from(INCOMPLETE),
        })
    }
}

/// Prints the bags, and on standard error the remarks on the data.
fn print_report(imported: &ImportReport) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    for bag in &imported.bags {
        writeln!(out, "{}", bag.display())?;
    }
    if imported.kept > 0 {
        eprintln!(
            "wm-datasets: {} episodes were imported before",
            imported.kept
        );
    }
    let ranges = imported.ranges.iter().cloned();
    for line in ranges.chain(imported.notes.lines()) {
        eprintln!("wm-datasets: {line}");
    }
    if imported.skipped.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    for reason in &imported.skipped {
        eprintln!("wm-datasets: skipped: {reason}");
    }
    let (made, skipped) = (imported.bags.len(), imported.skipped.len());
    eprintln!("wm-datasets: {made} episodes imported, {skipped} skipped");
    Ok(ExitCode::from(INCOMPLETE))
}

fn run(command: Command) -> Result<ExitCode> {
    match command {
        Command::Import(command) => print_report(&command.run()?),
        Command::Export(ExportCommand::Lerobot(command)) => command.run(),
        Command::Convert(command) => command.run(),
        Command::Audit(command) => command.run(),
    }
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match run(Command::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("wm-datasets: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_are_a_number_or_a_range() {
        assert_eq!(parse_episodes("3"), Ok(3..=3));
        assert_eq!(parse_episodes("0..3"), Ok(0..=3));
        assert_eq!(parse_episodes("0..=3"), Ok(0..=3));
        for bad in ["", "a", "3..1", "-1", "1..", "..2"] {
            assert!(parse_episodes(bad).is_err(), "{bad}");
        }
    }
}
