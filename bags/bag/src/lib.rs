//! Reads, writes, cuts, converts and recovers rosbag2 bags.
//!
//! A bag is a folder with `metadata.yaml` and one or more `.mcap` files (profile `ros2`, messages in CDR, schemas in
//! `ros2msg` with their dependencies). The reader also accepts a single `.mcap`, the bag of a killed recorder (without
//! `metadata.yaml` or footer), files without chunks or summary, sqlite3 files, and the compressions of rosbag2.
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
//! for message in reader.messages().only_topics(["/task/instruction"]) {
//!     assert_eq!(message?.decode::<Text>()?.data, "put the cup on the plate");
//! }
//! # std::fs::remove_dir_all(&scratch).ok();
//! # Ok(())
//! # }
//! ```
//!
//! # API
//! | task | items |
//! |---|---|
//! | read | [`BagReader`], its [`Messages`], [`BagMessage`], [`TopicInfo`], [`BagSummary`] and [`BagWarning`] |
//! | write | [`BagWriter`], [`WriterOptions`], [`Compression`], [`StoragePreset`] |
//! | copy | [`cut`](fn@cut), [`convert`](fn@convert) with a [`Transform`], [`recover`](fn@recover) |
//! | definitions of types | [`Schema`], [`type_schema`], [`definitions`] |
//! | QoS | [`QosProfile`], [`known_qos`], [`LatchedMessages`] |
//! | select | [`TopicFilter`], [`Shard`] (the share of one process among many) |
//! | paths | [`set_aside`](fn@set_aside), [`free_name`], [`is_bag_file`], [`preferred_form`] |
//!
//! Every failure is a [`BagError`].
//!
//! # Invariants
//! - Messages come in log-time order across files; those of the same time in the order of the file.
//! - Memory is bounded by the chunks that overlap in time (one, in most bags), never by the file.
//! - CDR bytes are never changed, and decoded only by [`BagMessage::decode`]: by the bag's definition, fields by name.
//! - The writer passes each finished chunk to the operating system: a killed process loses at most the open chunk, and
//!   with a [`sync_interval`](WriterOptions::sync_interval) a power cut at most that interval and the open chunk.
//! - Any bytes in a file give messages or an error, never a panic; every length is checked against a named limit.
//! - Unreadable channels are skipped and named. Foxglove's pictures in protobuf are read as bytes.
//!
//! # Not supported
//! Attachments; writing sqlite3 or rosbag2's file and message compression. Playing and recording need ROS and a clock, so
//! nodes implement them.

mod bag_copy;
mod convert;
mod cut;
mod decoding;
pub mod definitions;
mod encoding;
mod error;
mod latched;
mod metadata;
mod qos;
mod reader;
mod recover;
mod schema;
mod set_aside;
mod shard;
mod summary;
mod topic;
mod topic_filter;
mod warning;
mod writer;

pub use convert::{Conversion, NewMessage, NewTopic, Omission, TopicTransform, Transform, convert};
pub use cut::{Cut, CutEnd, CutStart, cut};
pub use encoding::MessageEncoding;
pub use error::BagError;
pub use latched::{LatchedMessages, kept_messages, known_qos};
pub use qos::{Durability, QosProfile, Reliability};
pub use reader::{
    BagMessage, BagReader, Messages,
    stored_file::{is_bag_file, preferred_form},
};
pub use recover::{Loss, Losses, Recovery, recover};
pub use schema::{Schema, SchemaEncoding, type_schema};
pub use set_aside::{free_name, set_aside};
pub use shard::Shard;
pub use summary::{BagSummary, ORIGIN, TopicSummary};
pub use topic::TopicInfo;
pub use topic_filter::TopicFilter;
pub use warning::BagWarning;
pub use writer::{BagWriter, Compression, StoragePreset, WriterOptions};

/// Keys of a channel's metadata in a file (`rosbag2_storage_mcap`).
pub(crate) const QOS_KEY: &str = "offered_qos_profiles";
pub(crate) const TYPE_HASH_KEY: &str = "topic_type_hash";
