use std::{io, path::PathBuf};

use wm_msgs::cdr::CdrError;

/// A failure to read or write a bag. Each text names the file or topic, the expected and the actual value.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    #[error(
        "no bag at {0}: no such file or directory; expected the folder of a bag, or one of its .mcap files"
    )]
    NotFound(PathBuf),
    #[error("{path} is not a bag: {reason}")]
    NotABag { path: PathBuf, reason: String },
    #[error("{path} is not a bag: {reason}")]
    Empty { path: PathBuf, reason: &'static str },
    #[error(
        "{path} is stored as {storage}, expected mcap or sqlite3; convert it to mcap with `ros2 bag convert`"
    )]
    Storage { path: PathBuf, storage: String },
    /// A storage that [`recover`](fn@crate::recover) does not support.
    #[error("{path} is stored as sqlite3, expected MCAP; read it with `wm bag convert`")]
    NotRecoverable { path: PathBuf },
    #[error(
        "{path} uses rosbag2's {mode} compression in the format {format:?}, expected zstd; convert it with `ros2 bag convert`"
    )]
    RosbagCompression {
        path: PathBuf,
        /// `file` or `message`.
        mode: String,
        /// For example `lz4`.
        format: String,
    },
    #[error(
        "{path} needs a temporary file, which cannot be written in {folder}: {reason}; set TMPDIR to a folder with \
         enough room"
    )]
    NoRoom {
        path: PathBuf,
        folder: PathBuf,
        reason: String,
    },
    #[error("{path}: {reason}")]
    Sqlite { path: PathBuf, reason: String },
    /// A message that rosbag2 compressed cannot be decompressed. Other messages can still be read.
    #[error(
        "topic {topic}: the message of log time {log_time_ns} ns cannot be decompressed: {reason}"
    )]
    Message {
        topic: String,
        /// Its log time, in ns since the epoch.
        log_time_ns: u64,
        /// The decoder's error.
        reason: String,
    },
    #[error("{path}: {reason}")]
    Metadata { path: PathBuf, reason: String },
    #[error(
        "{dir}: metadata.yaml lists {file}, which does not exist; restore it, or read the other files of the folder \
         with `wm bag recover`"
    )]
    MissingFile {
        dir: PathBuf,
        /// The file, relative to the bag.
        file: PathBuf,
    },
    #[error("{path}: topic {topic} has no schema, so its type is unknown")]
    NoType { path: PathBuf, topic: String },
    #[error("{path}: topic {topic} has two types: {first} and {second}")]
    TypeConflict {
        /// The bag or file.
        path: PathBuf,
        topic: String,
        /// The type of earlier messages.
        first: String,
        /// The type of this message or definition.
        second: String,
    },
    /// A segment of a file, usually a chunk, is damaged. Messages after it can still be read.
    #[error("{path}: the chunk at byte {offset} is damaged: {reason}")]
    Chunk {
        path: PathBuf,
        offset: u64,
        reason: String,
    },
    #[error(
        "{path}: the chunk at byte {offset} overlaps other chunks in time, and the limit of {limit} bytes of sorted \
         messages is reached"
    )]
    Overlap {
        path: PathBuf,
        offset: u64,
        limit: usize,
    },
    #[error(
        "{0} already exists and is not an empty directory; bags are never overwritten, so choose another path"
    )]
    Exists(PathBuf),
    #[error("expected a message type as package/msg/Type, got {0:?}")]
    TypeName(String),
    #[error("expected an absolute topic name such as /camera/image_raw, got {0:?}")]
    TopicName(String),
    #[error(
        "topic {topic}: log time {log_time_ns} ns is beyond the largest time of rosbag2 (2^63 - 1)"
    )]
    LogTime { topic: String, log_time_ns: u64 },
    #[error("topic {topic}: expected CDR with its 4-byte header, got {len} bytes")]
    NotCdr { topic: String, len: usize },
    #[error("{path} has no topic {topic}; it has {}", topics.join(", "))]
    NoTopic {
        path: PathBuf,
        topic: String,
        topics: Vec<String>,
    },
    #[error("expected a regular expression of topic names, got {text:?}: {reason}")]
    TopicRegex { text: String, reason: String },
    #[error(
        "{path} has no messages from {start_ns} ns to {end_ns} ns: its messages are from {bag_start_ns} ns to \
         {bag_end_ns} ns since the epoch"
    )]
    NothingBetween {
        path: PathBuf,
        /// The requested start, in ns since the epoch.
        start_ns: u64,
        /// The requested end, exclusive, in ns since the epoch.
        end_ns: u64,
        /// Log time of the bag's first message, in ns since the epoch.
        bag_start_ns: u64,
        /// Log time of the bag's last message, in ns since the epoch.
        bag_end_ns: u64,
    },
    #[error("offered_qos_profiles: {0}")]
    Qos(String),
    #[error("topic {topic} has messages of type {actual}, expected {expected}")]
    WrongType {
        topic: String,
        expected: String,
        actual: String,
    },
    #[error("topic {topic}: {reason}")]
    Cdr { topic: String, reason: CdrError },
    #[error("topic {topic}: expected {type_name} in protobuf: {reason}")]
    Protobuf {
        topic: String,
        type_name: String,
        reason: String,
    },
    #[error("topic {topic}: the bag's definition of {type_name} does not fit: {reason}")]
    Definition {
        topic: String,
        type_name: String,
        reason: String,
    },
    #[error("cannot write {path}: {reason}")]
    Mcap {
        path: PathBuf,
        reason: mcap::McapError,
    },
    #[error("{path}: {reason}")]
    Io {
        path: PathBuf,
        /// The error. Not a `source`, since the text contains it.
        reason: io::Error,
    },
}

impl BagError {
    /// Converts an I/O error at `path`; a missing file becomes [`NotFound`](Self::NotFound).
    pub(crate) fn io(path: impl Into<PathBuf>, source: io::Error) -> Self {
        let path = path.into();
        match source.kind() {
            io::ErrorKind::NotFound => Self::NotFound(path),
            _ => Self::Io {
                path,
                reason: source,
            },
        }
    }
}
