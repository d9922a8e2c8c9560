//! `wm bag cut`.

use super::{
    output::{print_size, print_warnings},
    time::{parse_seconds, parse_stamp_ns},
    topic_options::TopicOptions,
};
use crate::output::print;
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use wm_bag::{CutEnd, CutStart, TopicSummary};
use wm_camera::transport::Transport;
use wm_program::progress::Progress;

/// Cuts a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "Messages, times, sequence numbers, schemas and QoS are not changed. For each latched (transient_local) topic,\n\
    the last message before the start is kept too, because it is still valid (all that differ on /tf_static). Its\n\
    log time becomes the start, so that it is played first; its publish time is kept. Offsets count from the\n\
    recording itself: messages without a time, more than a day from most others, do not move them.\n\n\
    STAMP is as in `wm bag info`: seconds since the epoch (1700000000.25) or a date (2023-11-14T22:13:20.25Z).\n\n\
    Examples:\n  \
    wm bag cut run part --start-offset 12.5 --duration 30\n  \
    wm bag cut run part --start-time 2023-11-14T22:13:20Z --end-time 2023-11-14T22:14:00Z\n  \
    wm bag cut run cameras -e '^/camera/' -x '/compressedDepth$'\n  \
    wm bag cut run small --exclude-topics /camera/image_raw\n\n\
    Exit codes: 0 done, 3 the bag is damaged and only its readable part was kept, 1 failed."
)]
pub(crate) struct CutCommand {
    /// Folder of the bag, or one of its files
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Folder for the new bag
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Start this many seconds after the bag's first message
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds)]
    start_offset: Option<Duration>,
    /// End this many seconds after the start; a message at exactly that time is not included
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds)]
    duration: Option<Duration>,
    /// Start at this log time
    #[arg(long, value_name = "STAMP", value_parser = parse_stamp_ns, conflicts_with = "start_offset")]
    start_time: Option<u64>,
    /// End before this log time
    #[arg(long, value_name = "STAMP", value_parser = parse_stamp_ns, conflicts_with = "duration")]
    end_time: Option<u64>,
    #[command(flatten)]
    topics: TopicOptions,
}

impl CutCommand {
    pub(crate) fn run(self) -> Result<ExitCode> {
        let start = match (self.start_offset, self.start_time) {
            (Some(offset), _) => CutStart::After(offset),
            (None, Some(time_ns)) => CutStart::At(time_ns),
            (None, None) => CutStart::Beginning,
        };
        let end = match (self.duration, self.end_time) {
            (Some(duration), _) => CutEnd::After(duration),
            (None, Some(time_ns)) => CutEnd::Before(time_ns),
            (None, None) => CutEnd::End,
        };
        let topics = self.topics.filter()?;
        let progress = Progress::open_ended("cutting", "messages");
        let part = wm_bag::cut(&self.input, &self.output, start, end, &topics)?;
        drop(progress);
        print_size(&part.summary)?;
        for topic in &part.latched {
            print(format_args!(
                "kept the last message before the start: {topic}\n"
            ))?;
        }
        let is_video = |topic: &&TopicSummary| {
            Transport::of(&topic.name, &topic.type_name) == Some(Transport::Video)
        };
        let videos = part.summary.topics.iter().filter(is_video);
        for topic in videos.filter(|_| start != CutStart::Beginning) {
            let name = &topic.name;
            print(format_args!(
                "Note: {name} is compressed video: its packets up to the first keyframe after the start have no picture\n"
            ))?;
        }
        print_warnings(&part.warnings)
    }
}
