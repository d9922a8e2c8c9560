//! `wm bag record`, with the options of `ros2 bag record`.

use super::{parameters::Parameters, topic_options::TopicOptions};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wm_bag_nodes::recorder;
use wm_ros::NodeArgs;

/// Records a bag.
#[derive(Args, Debug)]
#[command(
    after_help = "At the end it says which messages did not get into the bag, by topic and cause: those that found a queue\n\
    full, those in no known form, and those that are missing in their publishers' numbering (best effort ones too;\n\
    what was sent before the first that came, or after the last, cannot be seen).\n\n\
    Space, in its terminal, pauses and resumes. Services, of rosbag2_interfaces: ~/pause ~/resume ~/is_paused\n\
    ~/split_bagfile ~/stop ~/record, in snapshot mode ~/snapshot; the node's name is /wm/recorder.\n\n\
    Examples:\n  \
    wm bag record -a -o run\n  \
    wm bag record -e '^/camera/' --topic-types wm_msgs/msg/Action -o run\n  \
    wm bag record -a -o last --snapshot-mode --max-cache-size 100000000\n  \
    wm bag record /camera/image_raw/compressed /wm/action -o run\n  \
    wm bag record -a -o run --max-bag-duration 60 --compression-format lz4\n  \
    wm bag record -a -o run --max-bag-size 1000000000 --storage-preset-profile fastwrite\n\n\
    Exit codes: 0 everything is in the bag, 3 something was lost, 1 failed."
)]
pub struct RecordCommand {
    /// Folder of the new bag
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Topics to record; as --topics
    #[arg(value_name = "TOPIC")]
    names: Vec<String>,
    /// Record all topics that are not hidden, those that appear later too
    #[arg(short, long, visible_alias = "all-topics", conflicts_with_all = ["names", "topics", "regex", "topic_types"])]
    all: bool,
    #[command(flatten)]
    topics: TopicOptions,
    /// Record the topics of these types, too
    #[arg(long, value_name = "TYPE", num_args = 1..)]
    topic_types: Vec<String>,
    /// Do not record the topics of these types
    #[arg(long, value_name = "TYPE", num_args = 1..)]
    exclude_topic_types: Vec<String>,
    /// YAML file of quality of service by topic, as ros2 bag reads it
    #[arg(long, value_name = "FILE")]
    qos_profile_overrides_path: Option<PathBuf>,
    /// Hold the latest messages back, as many as --max-cache-size takes, and write them when ~/snapshot is called
    #[arg(long)]
    snapshot_mode: bool,
    /// Record nothing until it is resumed
    #[arg(long)]
    start_paused: bool,
    /// Leave the keys of the terminal alone
    #[arg(long)]
    disable_keyboard_controls: bool,
    /// Log times are those of /clock; nothing is recorded before it speaks
    #[arg(long)]
    use_sim_time: bool,
    /// What is logged: debug, info, warn, error or fatal
    #[arg(long, value_name = "LEVEL")]
    log_level: Option<String>,
    /// Replace a bag that is there already, once the new one holds a message
    #[arg(long, conflicts_with = "rename_existing")]
    overwrite: bool,
    /// Give what is there already a name with its time
    #[arg(long)]
    rename_existing: bool,
    /// Folder below which ~/record may make bags [default: the folder that DIR is in]
    #[arg(long, value_name = "DIR")]
    root: Option<PathBuf>,
    /// Begin the bag's next file (name_1.mcap and so on) at this size; 0: never
    #[arg(short = 'b', long, value_name = "BYTES")]
    max_bag_size: Option<i64>,
    /// Begin the bag's next file after this time; 0: never
    #[arg(short = 'd', long, value_name = "SECONDS")]
    max_bag_duration: Option<i64>,
    /// Messages that may wait for the disk; what finds no room is dropped and counted [default: 256 MiB]
    #[arg(long, value_name = "BYTES")]
    max_cache_size: Option<i64>,
    /// What is compressed: chunks of the file by --compression-format, which is MCAP's own way. rosbag2's modes file and
    /// message are refused: they hide the messages from other readers of MCAP
    #[arg(long, value_name = "MODE", value_parser = parse_compression_mode)]
    compression_mode: Option<String>,
    /// Compression of the chunks [default: zstd]
    #[arg(long, value_name = "FORMAT", value_parser = ["none", "zstd", "lz4"])]
    compression_format: Option<String>,
    /// rosbag2's presets: fastwrite (no chunks, no compression), zstd_fast (fastest level, no CRC of the chunks),
    /// zstd_small (slowest level, chunks of 4 MiB)
    #[arg(long, value_name = "PRESET", value_parser = ["none", "fastwrite", "zstd_fast", "zstd_small"])]
    storage_preset_profile: Option<String>,
}

fn parse_compression_mode(text: &str) -> Result<String, String> {
    match text.to_lowercase().as_str() {
        mode @ "none" => Ok(mode.to_owned()),
        "file" | "message" => Err(format!(
            "rosbag2's compression mode {text} is not written; chunks are compressed instead, by --compression-format \
             none|zstd|lz4"
        )),
        _ => Err("expected none".to_owned()),
    }
}

impl RecordCommand {
    /// Runs it.
    pub fn run(mut self, ros_args: Vec<String>) -> Result<ExitCode> {
        self.topics.add(self.names);
        if !self.all && self.topics.is_all() && self.topic_types.is_empty() {
            let problem =
                "what is to be recorded? Name topics, or give --all, --regex or --topic-types\n";
            clap::Error::raw(clap::error::ErrorKind::MissingRequiredArgument, problem).exit();
        }
        let mut parameters = Parameters::new();
        parameters.set("output", &self.output)?;
        parameters.set("overwrite", self.overwrite)?;
        parameters.set("rename_existing", self.rename_existing)?;
        parameters.set_some("root", self.root)?;
        self.topics.parameters(&mut parameters)?;
        parameters.set_list("topic_types", &self.topic_types)?;
        parameters.set_list("exclude_topic_types", &self.exclude_topic_types)?;
        let overrides = self.qos_profile_overrides_path;
        parameters.set_some("qos_profile_overrides_path", overrides)?;
        parameters.set("snapshot_mode", self.snapshot_mode)?;
        parameters.set("start_paused", self.start_paused)?;
        parameters.set("disable_keyboard_controls", self.disable_keyboard_controls)?;
        parameters.set("use_sim_time", self.use_sim_time)?;
        parameters.set_some("max_bag_size", self.max_bag_size)?;
        parameters.set_some("max_bag_duration", self.max_bag_duration)?;
        parameters.set_some("max_cache_size", self.max_cache_size)?;
        parameters.set_some("compression_format", self.compression_format)?;
        parameters.set_some("storage_preset_profile", self.storage_preset_profile)?;
        parameters.log_level(self.log_level);
        Ok(recorder::run(&NodeArgs::parse(parameters.with(ros_args))?)?.into())
    }
}
