//! What is recorded and how it is written, from the node's parameters.

use super::{
    place::{Existing, Place},
    selection::Selection,
    writer::{CACHE_BYTES, CHUNK_TIME, SYNC_INTERVAL},
};
use crate::qos_overrides;
use anyhow::{Result, bail, ensure};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use wm_bag::{Compression, StoragePreset, TopicFilter, WriterOptions};
use wm_ros::{Descriptor, Node, Qos};

/// What the parameters say.
#[derive(Clone)]
pub(super) struct Options {
    /// Where bags are made.
    pub place: Place,
    pub selection: Selection,
    /// Quality of service of topics that is not to be their publishers'.
    pub qos_overrides: BTreeMap<String, Qos>,
    pub writer: WriterOptions,
    /// Bytes of messages that may wait for the disk.
    pub cache_bytes: usize,
    /// Whether messages are held back until a snapshot is asked for.
    pub is_snapshot: bool,
    pub is_starting_paused: bool,
    /// Whether the keys of its terminal control it.
    pub has_keyboard: bool,
}

/// The longest that a file of a bag may be told to be, in seconds: a hundred years, so that times do not overflow.
const LONGEST_S: i64 = 100 * 365 * 24 * 3600;

/// Declares the parameters, which have the names and meanings of rosbag2's options, and reads them.
pub(super) fn declare(node: &Node) -> Result<Options> {
    let number = |name: &str, default: i64, least: i64, most: i64, what: &str| -> Result<u64> {
        let descriptor = Descriptor::new(what).read_only().integers(least, most);
        let value = node.declare(name, default, descriptor)?.get();
        // The range has no negative number.
        Ok(value.unsigned_abs())
    };
    let text = |name: &str, default: &str, what: &str| -> Result<String> {
        let descriptor = Descriptor::new(what).read_only();
        Ok(node.declare(name, default.to_owned(), descriptor)?.get())
    };
    let flag = |name: &str, what: &str| -> Result<bool> {
        let descriptor = Descriptor::new(what).read_only();
        Ok(node.declare(name, false, descriptor)?.get())
    };
    let texts = |name: &str, what: &str| -> Result<Vec<String>> {
        let descriptor = Descriptor::new(what).read_only();
        let list = node.declare(name, Vec::<String>::new(), descriptor)?.get();
        // ROS cannot write an empty list of strings: [''] stands for it
        Ok(list.into_iter().filter(|item| !item.is_empty()).collect())
    };
    let topics = |name: &str, what: &str| -> Result<Vec<String>> {
        let names = texts(name, what)?.into_iter();
        names.map(|name| Ok(node.resolve(&name)?)).collect()
    };
    let folder = text(
        "output",
        "",
        "folder of the new bag; relative to the working directory",
    )?;
    let is_overwriting = flag(
        "overwrite",
        "replace a bag that is at output already, once the new one holds a message",
    )?;
    let is_renaming = flag(
        "rename_existing",
        "give what is at output already a name with its time, and begin the new bag there",
    )?;
    let root = text(
        "root",
        "",
        "folder below which ~/record may make bags; empty: the folder that output is in",
    )?;
    let named = topics(
        "topics",
        "topics to record; empty: all that are not hidden, or those of regex and topic_types",
    )?;
    let excluded = topics("exclude_topics", "topics not to record")?;
    let regex = text(
        "regex",
        "",
        "record topics in whose name this is found, too",
    )?;
    let exclude_regex = text(
        "exclude_regex",
        "",
        "do not record topics in whose name this is found",
    )?;
    let given = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
    let selection = Selection {
        topics: TopicFilter::new(
            named,
            given(&regex).as_deref(),
            excluded,
            given(&exclude_regex).as_deref(),
        )?,
        types: texts("topic_types", "record topics of these types, too")?,
        exclude_types: texts("exclude_topic_types", "do not record topics of these types")?,
    };
    let qos_overrides_path = text(
        "qos_profile_overrides_path",
        "",
        "YAML file of quality of service by topic, as ros2 bag reads it",
    )?;
    let is_snapshot = flag(
        "snapshot_mode",
        "hold the latest max_cache_size bytes back, and write them when ~/snapshot is called",
    )?;
    let is_starting_paused = flag("start_paused", "record nothing until it is resumed")?;
    let has_keyboard = !flag(
        "disable_keyboard_controls",
        "leave the keys of the terminal alone",
    )?;
    let max_file_bytes = number(
        "max_bag_size",
        0,
        0,
        i64::MAX,
        "begin the bag's next file at this size, in bytes; 0: never",
    )?;
    let max_file_seconds = number(
        "max_bag_duration",
        0,
        0,
        LONGEST_S,
        "begin the bag's next file after this time, in seconds; 0: never",
    )?;
    // A constant far below 2^63.
    let default_cache = CACHE_BYTES as i64;
    let cache_bytes = number(
        "max_cache_size",
        default_cache,
        1,
        i64::MAX,
        "bytes of messages that may wait for the disk; what finds no room is dropped and counted",
    )?;
    let format = text(
        "compression_format",
        "zstd",
        "compression of the bag's chunks: none, zstd or lz4",
    )?;
    let preset = text(
        "storage_preset_profile",
        "none",
        "preset of rosbag2's MCAP storage, instead of compression_format: none, fastwrite, zstd_fast or zstd_small",
    )?;
    ensure!(
        !folder.is_empty(),
        "parameter \"output\" is empty: name the folder of the new bag"
    );
    ensure!(
        !(is_overwriting && is_renaming),
        "\"overwrite\" and \"rename_existing\": give one of them"
    );
    let existing = match (is_overwriting, is_renaming) {
        (true, _) => Existing::Replaced,
        (_, true) => Existing::Renamed,
        _ => Existing::Refused,
    };
    let root = (!root.is_empty()).then(|| PathBuf::from(root));
    Ok(Options {
        place: Place::new(PathBuf::from(folder), root, existing)?,
        selection,
        qos_overrides: qos_overrides::read(qos_overrides_path.as_ref())?,
        is_snapshot,
        is_starting_paused,
        has_keyboard,
        writer: WriterOptions {
            chunk_duration: Some(CHUNK_TIME),
            sync_interval: Some(SYNC_INTERVAL),
            compression: compression(&format)?,
            preset: storage_preset(&preset)?,
            max_file_bytes: Some(max_file_bytes).filter(|bytes| *bytes > 0),
            max_file_duration: Some(max_file_seconds)
                .filter(|seconds| *seconds > 0)
                .map(Duration::from_secs),
            ..WriterOptions::default()
        },
        cache_bytes: usize::try_from(cache_bytes).unwrap_or(usize::MAX),
    })
}

fn compression(name: &str) -> Result<Compression> {
    match name {
        "none" => Ok(Compression::None),
        "zstd" => Ok(Compression::Zstd),
        "lz4" => Ok(Compression::Lz4),
        _ => bail!("parameter \"compression_format\": expected none, zstd or lz4, got {name:?}"),
    }
}

fn storage_preset(name: &str) -> Result<StoragePreset> {
    match name {
        "none" => Ok(StoragePreset::None),
        "fastwrite" => Ok(StoragePreset::FastWrite),
        "zstd_fast" => Ok(StoragePreset::ZstdFast),
        "zstd_small" => Ok(StoragePreset::ZstdSmall),
        _ => bail!(
            "parameter \"storage_preset_profile\": expected none, fastwrite, zstd_fast or zstd_small, got {name:?}"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_rosbag2() {
        assert_eq!(compression("lz4").unwrap(), Compression::Lz4);
        assert_eq!(
            storage_preset("fastwrite").unwrap(),
            StoragePreset::FastWrite
        );
        for error in [
            compression("gzip").unwrap_err(),
            storage_preset("gzip").unwrap_err(),
        ] {
            assert!(error.to_string().contains("got \"gzip\""), "{error}");
        }
    }
}
