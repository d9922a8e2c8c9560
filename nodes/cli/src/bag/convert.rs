//! `wm bag convert`.

use crate::{external, output::print};
use anyhow::Result;
use clap::{Args, ValueEnum};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag::{Compression, Transform, WriterOptions};
use wm_camera::{protobuf_topics::ProtobufTopics, transport::Transport};
use wm_program::progress::Progress;
use wm_robot_nodes::ending::Ending;

/// Converts a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "IN may be stored as MCAP or sqlite3, with rosbag2's file or message compression (zstd), by a recorder that was\n\
    killed too. Messages, times, sequence numbers, definitions and QoS are not changed. A bag without definitions\n\
    (sqlite3 before ROS 2 Iron) gets those of this machine where messages fit them. IN is not changed.\n\
    Pictures in protobuf (foxglove.CompressedImage, RawImage, CompressedVideo) become messages of ROS with the same\n\
    contents; other protobuf channels are left out by name.\n\n\
    --video jpeg converts h264 topics (foxglove CompressedVideo, FFMPEGPacket) to sensor_msgs/CompressedImage with\n\
    stamps, frame_id and QoS of the packets: /camera/image_raw/ffmpeg becomes /camera/image_raw/compressed. Packets\n\
    before the first keyframe, damaged ones and those that depend on missing ones have no picture; they are counted by\n\
    topic. It needs the program wm-datasets, which has the video decoder.\n\n\
    Examples:\n  \
    wm bag convert humble_run run\n  \
    wm bag convert run_0.mcap.zstd run --compression-format lz4\n  \
    wm bag convert drive pictures --video jpeg\n\n\
    Exit codes: 0 done, 3 messages are missing: the bag is damaged, or packets have no picture; 1 failed."
)]
pub(crate) struct ConvertCommand {
    /// Folder of the bag, or one of its files
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Folder for the new bag
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Compression of the new bag's chunks
    #[arg(long, value_name = "FORMAT", default_value = "zstd")]
    compression_format: Format,
    /// Compressed video: keep it, or convert it to JPEG pictures, which take more space
    #[arg(long, value_name = "WAY", default_value = "keep")]
    video: Video,
    /// JPEG quality of the pictures, 1 to 100 [default: 95]
    #[arg(long, value_name = "N", requires = "video", value_parser = clap::value_parser!(u8).range(1..=100))]
    jpeg_quality: Option<u8>,
}

/// The treatment of compressed video.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Video {
    Keep,
    Jpeg,
}

/// A compression of chunks, with the recorder's name.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    None,
    Zstd,
    Lz4,
}

impl ConvertCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        if self.video == Video::Jpeg {
            return external::exec("wm-datasets", self.arguments());
        }
        let options = WriterOptions {
            compression: match self.compression_format {
                Format::None => Compression::None,
                Format::Zstd => Compression::Zstd,
                Format::Lz4 => Compression::Lz4,
            },
            ..WriterOptions::default()
        };
        let progress = Progress::open_ended("converting", "messages");
        let mut transforms: [Box<dyn Transform>; 1] = [Box::new(ProtobufTopics)];
        let converted = wm_bag::convert(&self.input, &self.output, options, &mut transforms)?;
        drop(progress);
        print(format_args!("{converted}\n"))?;
        for topic in &converted.summary.topics {
            let transport = Transport::of(&topic.name, &topic.type_name);
            if transport == Some(Transport::Video) {
                let name = &topic.name;
                print(format_args!(
                    "{name} stays compressed video; --video jpeg converts it to pictures\n"
                ))?;
            }
        }
        Ok(Ending::lost_if(converted.is_lossy()).into())
    }

    /// The arguments of wm-datasets.
    fn arguments(self) -> Vec<OsString> {
        let format = self.compression_format.to_possible_value();
        let format = format.map_or_else(String::new, |value| value.get_name().to_owned());
        let mut arguments: Vec<OsString> = vec!["convert".into()];
        arguments.extend(["--compression-format".into(), format.into()]);
        if let Some(quality) = self.jpeg_quality {
            arguments.extend(["--jpeg-quality".into(), quality.to_string().into()]);
        }
        // a path may begin with a dash
        arguments.extend(["--".into(), self.input.into(), self.output.into()]);
        arguments
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        command: ConvertCommand,
    }

    #[test]
    fn options_reach_the_program_with_the_video_decoder() {
        let line = [
            "x",
            "--video",
            "jpeg",
            "--jpeg-quality",
            "80",
            "--compression-format",
            "lz4",
            "in",
            "--",
            "-out",
        ];
        let line = Line::try_parse_from(line).unwrap_or_else(|error| panic!("{error}"));
        let expected = [
            "convert",
            "--compression-format",
            "lz4",
            "--jpeg-quality",
            "80",
            "--",
            "in",
            "-out",
        ];
        assert_eq!(line.command.arguments(), expected.map(OsString::from));
        let alone = Line::try_parse_from(["x", "in", "out", "--jpeg-quality", "80"]);
        assert!(alone.is_err());
    }
}
