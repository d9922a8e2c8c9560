//! The recorder's parameters, checked.

use super::{
    place::{Existing, Place},
    selection::Selection,
    writer::{CACHE_BYTES, CHUNK_TIME, SYNC_INTERVAL},
};
use crate::qos_overrides;
use anyhow::{Result, ensure};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use wm_bag::{Compression, StoragePreset, TopicFilter, WriterOptions};
use wm_ros::{Node, Qos};

/// Longest duration of a file \[s\]: a hundred years, so that times do not overflow.
const LONGEST_S: i64 = 100 * 365 * 24 * 3600;

wm_ros::parameters! {
    /// The node's parameters. They have the names and meanings of rosbag2's options.
    pub(super) struct Parameters {
        /// Folder for the new bag, relative to the working directory.
        output: PathBuf = "";
        /// Replace an existing bag once the new one holds a message. This applies only to the bag of output: a bag that
        /// a service asks for must not exist yet.
        overwrite: bool = false;
        /// Rename an existing bag by adding the time of its last change to its name.
        rename_existing: bool = false;
        /// Calls of ~/record may create bags only below this folder; empty: the folder that contains output.
        root: PathBuf = "";
        /// Topics to record; empty: all that are not hidden, or those selected by regex and topic_types.
        topics: Vec<String> = Vec::<String>::new();
        /// Topics not to record.
        exclude_topics: Vec<String> = Vec::<String>::new();
        /// Also record topics whose name contains a match of this regular expression.
        regex: String = "";
        /// Do not record topics whose name contains a match of this regular expression.
        exclude_regex: String = "";
        /// Also record topics of these types.
        topic_types: Vec<String> = Vec::<String>::new();
        /// Do not record topics of these types.
        exclude_topic_types: Vec<String> = Vec::<String>::new();
        /// YAML file with the QoS of each topic, in the format of ros2 bag; empty: what all publishers of a topic
        /// offer.
        qos_profile_overrides_path: PathBuf = "";
        /// Snapshot mode: keep the latest max_cache_size bytes in memory, and write them when ~/snapshot is called.
        snapshot_mode: bool = false;
        /// Start paused: record nothing until the recorder is resumed.
        start_paused: bool = false;
        /// Ignore the keyboard.
        disable_keyboard_controls: bool = false;
        /// Split the bag: start its next file at this size [bytes]; 0: never.
        max_bag_size: u64 = 0;
        /// Split the bag: start its next file after this time [s]; 0: never.
        max_bag_duration: u64 = 0, in 0..=LONGEST_S;
        /// Maximum size of the messages that wait for the disk [bytes]; further messages are dropped and counted.
        max_cache_size: usize = CACHE_BYTES as i64, in 1..=i64::MAX;
        /// Compression of the bag's chunks.
        compression_format: Compression = "zstd", one_of {
            "none" => Compression::None, "zstd" => Compression::Zstd, "lz4" => Compression::Lz4,
        };
        /// Preset of rosbag2's MCAP storage, used instead of compression_format: fastwrite (no chunks, no compression),
        /// zstd_fast (fastest level, no chunk CRC), zstd_small (slowest level, chunks of 4 MiB).
        storage_preset_profile: StoragePreset = "none", one_of {
            "none" => StoragePreset::None, "fastwrite" => StoragePreset::FastWrite,
            "zstd_fast" => StoragePreset::ZstdFast, "zstd_small" => StoragePreset::ZstdSmall,
        };
        /// Added to the nice value of the thread that compresses and writes, as with nice(1). Above 0, other nodes and
        /// programs go first.
        nice: i32 = 0, in 0..=19;
    }
}

/// The checked parameters.
#[derive(Clone)]
pub(super) struct Options {
    /// Rules for the folders of bags.
    pub place: Place,
    pub selection: Selection,
    /// QoS of topics that differs from that of their publishers.
    pub qos_overrides: BTreeMap<String, Qos>,
    pub writer: WriterOptions,
    /// Most bytes of messages that wait for the disk.
    pub cache_bytes: usize,
    /// Whether messages wait in memory for a call of `~/snapshot`.
    pub is_snapshot: bool,
    pub is_starting_paused: bool,
    /// Whether the keys of the terminal pause and resume it.
    pub has_keyboard: bool,
    /// Added to the nice value of the thread that compresses and writes.
    pub nice: i32,
}

impl Options {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Names the invalid parameter.
    pub fn new(parameters: &Parameters, node: &Node) -> Result<Self> {
        ensure!(
            !parameters.output.as_os_str().is_empty(),
            "parameter \"output\" is empty: give the folder for the new bag"
        );
        ensure!(
            !(parameters.overwrite && parameters.rename_existing),
            "\"overwrite\" and \"rename_existing\" exclude each other: set only one of them"
        );
        let existing = match (parameters.overwrite, parameters.rename_existing) {
            (true, _) => Existing::Replaced,
            (_, true) => Existing::Renamed,
            _ => Existing::Refused,
        };
        let root = Some(parameters.root.clone()).filter(|root| !root.as_os_str().is_empty());
        let resolved = |names: &[String]| -> Result<Vec<String>> {
            let names = names.iter();
            names.map(|name| Ok(node.resolve(name)?)).collect()
        };
        let non_empty = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
        let selection = Selection {
            topics: TopicFilter::new(
                resolved(&parameters.topics)?,
                non_empty(&parameters.regex).as_deref(),
                resolved(&parameters.exclude_topics)?,
                non_empty(&parameters.exclude_regex).as_deref(),
            )?,
            types: parameters.topic_types.clone(),
            exclude_types: parameters.exclude_topic_types.clone(),
        };
        Ok(Self {
            place: Place::new(parameters.output.clone(), root, existing)?,
            selection,
            qos_overrides: qos_overrides::read(&parameters.qos_profile_overrides_path)?,
            is_snapshot: parameters.snapshot_mode,
            is_starting_paused: parameters.start_paused,
            has_keyboard: !parameters.disable_keyboard_controls,
            writer: WriterOptions {
                chunk_duration: Some(CHUNK_TIME),
                sync_interval: Some(SYNC_INTERVAL),
                compression: parameters.compression_format,
                preset: parameters.storage_preset_profile,
                max_file_bytes: Some(parameters.max_bag_size).filter(|bytes| *bytes > 0),
                max_file_duration: Some(parameters.max_bag_duration)
                    .filter(|seconds| *seconds > 0)
                    .map(Duration::from_secs),
                ..WriterOptions::default()
            },
            cache_bytes: parameters.max_cache_size,
            nice: parameters.nice,
        })
    }
}
