use std::{io, path::PathBuf};

use wm_msgs::cdr::CdrError;

/// A failure to read or write a bag. Each text names the file or topic, the expected and the actual value.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// The path does not exist.
    #[error(
        "no bag at {0}: no such file or directory; expected the folder of a bag, or one of its .mcap files"
    )]
    NotFound(PathBuf),
    /// The path is neither a bag folder nor a file of a bag.
    #[error("{path} is not a bag: {reason}")]
    NotABag {
        /// The path.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// An empty file, or a folder without files of a bag.
    #[error("{path} is not a bag: {reason}")]
    Empty {
        /// The path.
        path: PathBuf,
        /// The fault.
        reason: &'static str,
    },
    /// A storage that the reader does not support.
    #[error(
        "{path} is stored as {storage}, expected mcap or sqlite3; convert it to mcap with `ros2 bag convert`"
    )]
    Storage {
        /// The path.
        path: PathBuf,
        /// The storage identifier.
        storage: String,
    },
    /// A storage that [`recover`](fn@crate::recover) does not support.
    #[error("{path} is stored as sqlite3, expected MCAP; read it with `wm bag convert`")]
    NotRecoverable {
        /// The file.
        path: PathBuf,
    },
    /// A compression of rosbag2 that the reader does not support.
    #[error(
        "{path} uses rosbag2's {mode} compression in the format {format:?}, expected zstd; convert it with `ros2 bag convert`"
    )]
    RosbagCompression {
        /// The path.
        path: PathBuf,
        /// `file` or `message`.
        mode: String,
        /// For example `lz4`.
        format: String,
    },
    /// A temporary file cannot be written.
    #[error(
        "{path} needs a temporary file, which cannot be written in {folder}: {reason}; set TMPDIR to a folder with \
         enough room"
    )]
    NoRoom {
        /// The file of the bag.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
        /// The error.
        reason: String,
    },
    /// sqlite3 cannot read the file.
    #[error("{path}: {reason}")]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// The error.
        reason: String,
    },
    /// A message that rosbag2 compressed cannot be decompressed. Other messages can still be read.
    #[error(
        "topic {topic}: the message of log time {log_time_ns} ns cannot be decompressed: {reason}"
    )]
    Message {
        /// The topic.
        topic: String,
        /// Its log time, in ns since the epoch.
        log_time_ns: u64,
        /// The decoder's error.
        reason: String,
    },
    /// `metadata.yaml` is invalid.
    #[error("{path}: {reason}")]
    Metadata {
        /// The `metadata.yaml`.
        path: PathBuf,
        /// The fault.
        reason: String,
    },
    /// A file that `metadata.yaml` lists is missing.
    #[error(
        "{dir}: metadata.yaml lists {file}, which does not exist; restore it, or read the other files of the folder \
         with `wm bag recover`"
    )]
    MissingFile {
        /// The bag.
        dir: PathBuf,
        /// The file, relative to the bag.
        file: PathBuf,
    },
    /// A topic without a type.
    #[error("{path}: topic {topic} has no schema, so its type is unknown")]
    NoType {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
    },
    /// A topic with two types.
    #[error("{path}: topic {topic} has two types: {first} and {second}")]
    TypeConflict {
        /// The bag or file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The type of earlier messages.
        first: String,
        /// The type of this message or definition.
        second: String,
    },
    /// A segment of a file, usually a chunk, is damaged. Messages after it can still be read.
    #[error("{path}: the chunk at byte {offset} is damaged: {reason}")]
    Chunk {
        /// The file.
        path: PathBuf,
        /// First byte of the record.
        offset: u64,
        /// The fault.
        reason: String,
    },
    /// Too many chunks overlap in time to sort their messages within the memory limit.
    #[error(
        "{path}: the chunk at byte {offset} overlaps other chunks in time, and the limit of {limit} bytes of sorted \
         messages is reached"
    )]
    Overlap {
        /// The file.
        path: PathBuf,
        /// First byte of the chunk.
        offset: u64,
        /// The limit.
        limit: usize,
    },
    /// The output exists and is not an empty folder.
    #[error(
        "{0} already exists and is not an empty directory; bags are never overwritten, so choose another path"
    )]
    Exists(PathBuf),
    /// A type name that is not `package/msg/Type`.
    #[error("expected a message type as package/msg/Type, got {0:?}")]
    TypeName(String),
    /// A topic name that ROS does not allow in a bag.
    #[error("expected an absolute topic name such as /camera/image_raw, got {0:?}")]
    TopicName(String),
    /// A time that rosbag2 cannot store.
    #[error(
        "topic {topic}: log time {log_time_ns} ns is beyond the largest time of rosbag2 (2^63 - 1)"
    )]
    LogTime {
        /// The topic.
        topic: String,
        /// The time.
        log_time_ns: u64,
    },
    /// A message that is not CDR with its header.
    #[error("topic {topic}: expected CDR with its 4-byte header, got {len} bytes")]
    NotCdr {
        /// The topic.
        topic: String,
        /// Number of bytes.
        len: usize,
    },
    /// The bag does not have the requested topic.
    #[error("{path} has no topic {topic}; it has {}", topics.join(", "))]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// The requested topic.
        topic: String,
        /// The topics of the bag.
        topics: Vec<String>,
    },
    /// An invalid regular expression.
    #[error("expected a regular expression of topic names, got {text:?}: {reason}")]
    TopicRegex {
        /// The text.
        text: String,
        /// The fault.
        reason: String,
    },
    /// A time span without messages.
    #[error(
        "{path} has no messages from {start_ns} ns to {end_ns} ns: its messages are from {bag_start_ns} ns to \
         {bag_end_ns} ns since the epoch"
    )]
    NothingBetween {
        /// The bag.
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
    /// An invalid QoS profile.
    #[error("offered_qos_profiles: {0}")]
    Qos(String),
    /// The requested type differs from the message's type.
    #[error("topic {topic} has messages of type {actual}, expected {expected}")]
    WrongType {
        /// The topic.
        topic: String,
        /// The requested type.
        expected: String,
        /// The type in the bag.
        actual: String,
    },
    /// A message that cannot be decoded as its type, or encoded.
    #[error("topic {topic}: {reason}")]
    Cdr {
        /// The topic.
        topic: String,
        /// The error.
        reason: CdrError,
    },
    /// A protobuf message that cannot be decoded as its type.
    #[error("topic {topic}: expected {type_name} in protobuf: {reason}")]
    Protobuf {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// The fault.
        reason: String,
    },
    /// The bag's definition does not fit the requested type.
    #[error("topic {topic}: the bag's definition of {type_name} does not fit: {reason}")]
    Definition {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// The mismatch.
        reason: String,
    },
    /// The MCAP library could not write.
    #[error("cannot write {path}: {reason}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// The error.
        reason: mcap::McapError,
    },
    /// An error of the operating system.
    #[error("{path}: {reason}")]
    Io {
        /// The file or directory.
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
