//! `wm bag convert --video jpeg`, which needs this program's video decoder.

use std::{io::Write as _, path::PathBuf, process::ExitCode};

use anyhow::Result;
use clap::{Args, ValueEnum};
use wm_bag::{BagReader, Compression, Transform, WriterOptions, convert};
use wm_camera::{protobuf_topics::ProtobufTopics, video::VideoTopics};
use wm_program::progress::Progress;

use crate::INCOMPLETE;

/// Converts a bag and its video topics to pictures.
#[derive(Args, Debug)]
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
    /// JPEG quality of the pictures, 1 to 100
    #[arg(long, default_value_t = wm_import::ImportOptions::default().jpeg_quality, value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg_quality: u8,
}

/// A compression of chunks, by its name in the recorder.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    None,
    Zstd,
    Lz4,
}

impl ConvertCommand {
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
        let topics = VideoTopics::of(&BagReader::open(&self.input)?, self.jpeg_quality);
        let unconverted = topics.skipped().to_vec();
        let mut transforms: [Box<dyn Transform>; 2] = [Box::new(topics), Box::new(ProtobufTopics)];
        let converted = convert(&self.input, &self.output, options, &mut transforms)?;
        drop(progress);
        let mut out = std::io::stdout().lock();
        writeln!(out, "{converted}")?;
        for (topic, reason) in unconverted {
            writeln!(out, "Warning: {topic} stays compressed video: {reason}")?;
        }
        Ok(match converted.is_lossy() {
            true => ExitCode::from(INCOMPLETE),
            false => ExitCode::SUCCESS,
        })
    }
}
