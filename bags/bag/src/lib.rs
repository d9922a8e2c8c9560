//! rosbag2 bags in MCAP: a reader, a writer and their `metadata.yaml`.
//!
//! A bag is a directory with `metadata.yaml` and one or more `.mcap` files (profile `ros2`, messages in CDR, schemas in
//! `ros2msg` with their dependencies). The reader also takes a lone `.mcap`, a bag whose recorder was killed (no
//! `metadata.yaml`, no footer), files without chunks or without a summary, sqlite3 files, and what rosbag2 compresses. [`recover`] repairs such a bag,
//! [`cut`](fn@cut) shortens one, [`convert`](fn@convert) makes MCAP of any.
//!
//! ```
//! use wm_bag::{BagReader, BagWriter, QosProfile, WriterOptions};
//! use wm_msgs::std_msgs::String as Text;
//!
//! # fn main() -> Result<(), wm_bag::BagError> {
//! # let scratch = std::env::temp_dir().join(format!("wm_bag_example_{}", std::process::id()));
//! let mut writer = BagWriter::create(&scratch, WriterOptions::default())?;
//! writer.add_topic::<Text>("/task/instruction", QosProfile::latched())?;
//! writer.write("/task/instruction", &Text { data: "put the cup on the plate".into() }, 1_700_000_000_000_000_000)?;
//! writer.finish()?;
//!
//! let reader = BagReader::open(&scratch)?;
//! for message in reader.messages() {
//!     println!("{}", message?.decode::<Text>()?.data);
//! }
//! # std::fs::remove_dir_all(&scratch).ok();
//! # Ok(())
//! # }
//! ```
//!
//! # What holds
//! - Messages come in log-time order, across files; those of the same time in the order of the file.
//! - Memory is bounded by the chunks that overlap in time (one, in most bags), never by the file.
//! - CDR bytes are handed over as they were written; nothing is decoded unless asked for.
//! - The writer hands each finished chunk to the operating system: a killed process loses at most the open chunk,
//!   and with a [`sync_interval`](WriterOptions::sync_interval) a power cut at most that interval and the open chunk.
//! - Any bytes in a file give messages or an error, never a panic; every length is held against a named limit.
//!
//! - A message is decoded by the definition that the bag carries, its fields by their names.
//! - A channel that cannot be read is left out by name, and the others are read. Pictures in protobuf
//!   ([`PROTOBUF_TYPES`]) are read as bytes.
//!
//! # What it does not do
//! Attachments; writing sqlite3, or with the file and message compression of rosbag2 (both are read). No ROS and no clock:
//! playing and recording live in the nodes.

mod aside;
mod convert;
mod cut;
mod decoding;
pub mod definitions;
mod encoding;
mod error;
mod latched;
mod metadata;
mod part;
mod qos;
mod reader;
mod recover;
mod schema;
mod shard;
mod summary;
mod topic;
mod topic_filter;
mod warning;
mod writer;

pub use aside::{free_name, set_aside};
pub use convert::{Converted, NewMessage, NewTopic, Omission, TopicTransform, Transform, convert};
pub use cut::{Cut, CutEnd, CutStart, cut};
pub use encoding::{MessageEncoding, PROTOBUF_TYPES};
pub use error::BagError;
pub use latched::{Latched, kept_messages, known_qos};
pub use qos::{Durability, QosProfile, Reliability};
pub use reader::{
    BagMessage, BagReader, Messages,
    stored_file::{is_bag_file, preferred_form},
};
pub use recover::{Loss, Losses, Recovery, recover};
pub use schema::{Schema, SchemaEncoding, type_schema};
pub use shard::Shard;
pub use summary::{BagSummary, ORIGIN, TopicSummary};
pub use topic::TopicInfo;
pub use topic_filter::TopicFilter;
pub use warning::BagWarning;
pub use writer::{BagWriter, Compression, StoragePreset, WriterOptions};

/// Keys of a channel's metadata in the file, as `rosbag2_storage_mcap` writes them.
pub(crate) const QOS_KEY: &str = "offered_qos_profiles";
pub(crate) const TYPE_HASH_KEY: &str = "topic_type_hash";
