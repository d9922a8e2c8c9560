//! `wm bag convert`.

use super::output::{print_size, print_warnings};
use crate::output::print;
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag::{Compression, WriterOptions};
use wm_progress::Progress;

/// Converts a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "IN may be stored as MCAP or sqlite3, with rosbag2's file or message compression (zstd), by a recorder that was\n\
    killed too. Messages, times, sequence numbers, definitions and QoS are not changed. A bag without definitions\n\
    (sqlite3 before ROS 2 Iron) gets those of this machine where messages fit them. IN is not changed.\n\n\
    Examples:\n  \
    wm bag convert humble_run run\n  \
    wm bag convert run_0.mcap.zstd run --compression-format lz4\n\n\
    Exit codes: 0 done, 3 the bag is damaged and only its readable part was converted, 1 failed."
)]
pub struct ConvertCommand {
    /// Folder of the bag, or one of its files
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Folder for the new bag
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Compression of the new bag's chunks
    #[arg(long, value_name = "FORMAT", default_value = "zstd")]
    compression_format: Format,
}

/// A compression of chunks, as the recorder names it.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    None,
    Zstd,
    Lz4,
}

impl ConvertCommand {
    /// Runs it.
    pub fn run(self) -> Result<ExitCode> {
        let options = WriterOptions {
            compression: match self.compression_format {
                Format::None => Compression::None,
                Format::Zstd => Compression::Zstd,
                Format::Lz4 => Compression::Lz4,
            },
            ..WriterOptions::default()
        };
        let progress = Progress::open_ended("converting", "messages");
        let converted = wm_bag::convert(&self.input, &self.output, options, &mut [])?;
        drop(progress);
        print_size(&converted.summary)?;
        for (old, new) in &converted.transformed {
            print(format_args!("transformed {old} to {new}\n"))?;
        }
        for topic in &converted.undefined {
            print(format_args!(
                "Warning: the type of {topic} has no definition in the new bag\n"
            ))?;
        }
        print_warnings(&converted.warnings)
    }
}
