//! `wm-lerobot`: LeRobot datasets as bags, and back. `wm bag import lerobot` and `wm bag export lerobot` call it; parquet
//! and AV1 are heavy to build, and so a program of its own.
//!
//! Exit codes: 0 done, 1 failed, 2 wrong usage.

use std::{io::Write as _, ops::RangeInclusive, path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Args, Parser};
use tracing_subscriber::EnvFilter;
use wm_lerobot::{ExportOptions, ImportOptions, export, import};

/// LeRobot datasets as bags, and bags as LeRobot datasets.
#[derive(Debug, Parser)]
#[command(name = "wm-lerobot", version)]
enum Command {
    /// Make bags of a LeRobot dataset, v2.1 or v3.0
    Import(ImportCommand),
    /// Make a LeRobot v3.0 dataset of bags
    Export(ExportCommand),
}

#[derive(Args, Debug)]
struct ImportCommand {
    /// Folder of the dataset (with meta/info.json)
    source: PathBuf,
    /// Folder for the bags, one an episode
    output: PathBuf,
    /// Import these episodes only: FIRST..LAST, the last one too, or one number
    #[arg(long, value_parser = episodes)]
    episodes: Option<RangeInclusive<i64>>,
    /// JPEG quality of the frames of videos, 1 to 100
    #[arg(long, default_value_t = ImportOptions::default().jpeg_quality, value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg_quality: u8,
}

#[derive(Args, Debug)]
struct ExportCommand {
    /// Folder for the dataset
    output: PathBuf,
    /// The bags, one episode each, or several where /task/success says so
    #[arg(required = true)]
    bags: Vec<PathBuf>,
    /// Frames a second [default: the rate of /wm/action]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    fps: Option<u32>,
    /// The dataset's robot_type
    #[arg(long)]
    robot_type: Option<String>,
    /// A camera's topic, once for each [default: every .../image_raw and .../image_raw/compressed]
    #[arg(long = "camera", value_name = "TOPIC")]
    cameras: Vec<String>,
    /// The task of episodes without /task/instruction
    #[arg(long, default_value = "")]
    task: String,
}

/// `3`, or `0..3` with the last one too.
fn episodes(text: &str) -> Result<RangeInclusive<i64>, String> {
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
            "expected the first not after the last, got {text:?}"
        ));
    }
    Ok(first..=last)
}

fn run(command: Command) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match command {
        Command::Import(command) => {
            let options = ImportOptions {
                episodes: command.episodes,
                jpeg_quality: command.jpeg_quality,
                ..ImportOptions::default()
            };
            for bag in import(&command.source, &command.output, &options)? {
                writeln!(out, "{}", bag.display())?;
            }
        }
        Command::Export(command) => {
            let options = ExportOptions {
                fps: command.fps,
                robot_type: command.robot_type,
                cameras: command.cameras,
                task: command.task,
                ..ExportOptions::default()
            };
            let exported = export(&command.bags, &command.output, &options)?;
            for line in &exported.resampled {
                eprintln!("wm-lerobot: {line}");
            }
            writeln!(
                out,
                "{}: {} episodes, {} frames at {} a second",
                command.output.display(),
                exported.episodes,
                exported.frames,
                exported.fps
            )?;
        }
    }
    Ok(())
}

fn main() -> ExitCode {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .init();
    match run(Command::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("wm-lerobot: {error:#}");
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episodes_are_a_number_or_a_range() {
        assert_eq!(episodes("3"), Ok(3..=3));
        assert_eq!(episodes("0..3"), Ok(0..=3));
        assert_eq!(episodes("0..=3"), Ok(0..=3));
        for bad in ["", "a", "3..1", "-1", "1..", "..2"] {
            assert!(episodes(bad).is_err(), "{bad}");
        }
    }
}
