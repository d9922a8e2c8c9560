use std::{io, path::PathBuf};

use wm_msgs::cdr::CdrError;

/// Why a bag cannot be read or written. Each text names the file or topic, what was expected and what came.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BagError {
    /// Nothing is at this path.
    #[error(
        "no bag at {0}: no such file or directory; expected the folder of a bag, or one of its .mcap files"
    )]
    NotFound(PathBuf),
    /// The path is neither a bag directory nor an MCAP file.
    #[error("{path} is not a bag: {reason}")]
    NotABag {
        /// What was opened.
        path: PathBuf,
        /// What was found instead.
        reason: String,
    },
    /// An empty file, or a directory with no `.mcap` in it.
    #[error("{path} is no bag: {reason}")]
    Empty {
        /// What was opened.
        path: PathBuf,
        /// What is missing.
        reason: &'static str,
    },
    /// A storage that is not read here.
    #[error(
        "{path} is stored as {storage}, expected mcap or sqlite3; convert it to mcap with `ros2 bag convert`"
    )]
    Storage {
        /// What was opened.
        path: PathBuf,
        /// The storage identifier.
        storage: String,
    },
    /// A bag that has to be converted before it can be recovered.
    #[error(
        "{path} is stored as sqlite3, and only MCAP files are recovered byte by byte; read what is left of it with `wm bag convert`"
    )]
    NotRecoverable {
        /// The file.
        path: PathBuf,
    },
    /// A compression of rosbag2 that is not read here.
    #[error(
        "{path} uses rosbag2's {mode} compression in the format {format:?}, expected zstd; convert it with `ros2 bag convert`"
    )]
    RosbagCompression {
        /// What was opened.
        path: PathBuf,
        /// `file` or `message`.
        mode: String,
        /// For example `lz4`.
        format: String,
    },
    /// A temporary file cannot be written.
    #[error(
        "{path} is read from a temporary file, which cannot be written in {folder}: {reason}; set TMPDIR to a folder with \
         enough room"
    )]
    NoRoom {
        /// The file of the bag.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// sqlite3 cannot read the file.
    #[error("{path}: {reason}")]
    Sqlite {
        /// The file.
        path: PathBuf,
        /// What it said.
        reason: String,
    },
    /// A message that was compressed by itself and cannot be decompressed. The others can still be read.
    #[error(
        "topic {topic}: the message of log time {log_time_ns} ns cannot be decompressed: {reason}"
    )]
    Message {
        /// The topic.
        topic: String,
        /// Its log time, in ns since the epoch.
        log_time_ns: u64,
        /// What the decoder met.
        reason: String,
    },
    /// `metadata.yaml` cannot be understood.
    #[error("{path}: {reason}")]
    Metadata {
        /// The `metadata.yaml`.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A file that `metadata.yaml` lists is missing.
    #[error(
        "{dir}: metadata.yaml lists {file}, which does not exist; put it back, or read the other files of the folder \
         with `wm bag recover`"
    )]
    MissingFile {
        /// The bag.
        dir: PathBuf,
        /// The file, relative to the bag.
        file: PathBuf,
    },
    /// A topic whose type the file does not name.
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
        /// The type it had first.
        first: String,
        /// The type it has now.
        second: String,
    },
    /// A stretch of a file (a chunk, most often) is damaged. The messages after it can still be read.
    #[error("{path}: the chunk at byte {offset} is damaged: {reason}")]
    Chunk {
        /// The file.
        path: PathBuf,
        /// Where the record begins.
        offset: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// So many chunks cover the same time that their messages cannot be put in order within bounds.
    #[error(
        "{path}: the chunk at byte {offset} overlaps other chunks in time, and {limit} bytes of their messages are \
         already waiting"
    )]
    Overlap {
        /// The file.
        path: PathBuf,
        /// Where the chunk begins.
        offset: u64,
        /// How many bytes may wait.
        limit: usize,
    },
    /// The directory to write to holds something already.
    #[error(
        "{0} already exists and is not an empty directory; bags are never overwritten, so choose another path"
    )]
    Exists(PathBuf),
    /// A type's name that is not `package/msg/Type`.
    #[error("expected a message type as package/msg/Type, got {0:?}")]
    TypeName(String),
    /// A topic's name that ROS does not allow in a bag.
    #[error("expected an absolute topic name such as /camera/image_raw, got {0:?}")]
    TopicName(String),
    /// A time that rosbag2 cannot hold.
    #[error(
        "topic {topic}: log time {log_time_ns} ns is beyond the largest time of rosbag2 (2^63 - 1)"
    )]
    LogTime {
        /// The topic.
        topic: String,
        /// The time that was given.
        log_time_ns: u64,
    },
    /// A message that is not CDR with its header.
    #[error("topic {topic}: expected CDR with its 4-byte header, got {len} bytes")]
    NotCdr {
        /// The topic.
        topic: String,
        /// Bytes that were given.
        len: usize,
    },
    /// A topic that is not there.
    #[error("{path} has no topic {topic}; it has {}", topics.join(", "))]
    NoTopic {
        /// The bag.
        path: PathBuf,
        /// The topic that was requested.
        topic: String,
        /// Those that are there.
        topics: Vec<String>,
    },
    /// Text that is no regular expression.
    #[error("expected a regular expression of topic names, got {text:?}: {reason}")]
    TopicRegex {
        /// The text.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A time in which a bag has nothing.
    #[error(
        "{path} has no messages from {start_ns} ns to before {end_ns} ns: its messages are from {bag_start_ns} ns to \
         {bag_end_ns} ns since the epoch"
    )]
    NothingBetween {
        /// The bag.
        path: PathBuf,
        /// The start that was requested, in ns since the epoch.
        start_ns: u64,
        /// The end that was requested, in ns since the epoch.
        end_ns: u64,
        /// Log time of the bag's first message, in ns since the epoch.
        bag_start_ns: u64,
        /// Log time of the bag's last message, in ns since the epoch.
        bag_end_ns: u64,
    },
    /// A QoS profile that cannot be understood.
    #[error("offered_qos_profiles: {0}")]
    Qos(String),
    /// A message was asked for as another type than it has.
    #[error("topic {topic} has messages of type {actual}, expected {expected}")]
    WrongType {
        /// The topic.
        topic: String,
        /// The type that was requested.
        expected: String,
        /// The type that the bag names.
        actual: String,
    },
    /// A message that is not of its type, or cannot be encoded.
    #[error("topic {topic}: {reason}")]
    Cdr {
        /// The topic.
        topic: String,
        /// What the codec met.
        reason: CdrError,
    },
    /// A message in protobuf that is not of its type.
    #[error("topic {topic}: expected {type_name} in protobuf: {reason}")]
    Protobuf {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// What is wrong.
        reason: String,
    },
    /// A message whose definition in the bag does not fit the type that was requested.
    #[error("topic {topic}: the bag's definition of {type_name} does not fit: {reason}")]
    Definition {
        /// The topic.
        topic: String,
        /// The type.
        type_name: String,
        /// What does not fit.
        reason: String,
    },
    /// The MCAP library could not write.
    #[error("cannot write {path}: {reason}")]
    Mcap {
        /// The file.
        path: PathBuf,
        /// What it met.
        reason: mcap::McapError,
    },
    /// The operating system refused.
    #[error("{path}: {reason}")]
    Io {
        /// The file or directory.
        path: PathBuf,
        /// What it said. No source, since the message has it.
        reason: io::Error,
    },
}

impl BagError {
    /// An I/O error at `path`, with a missing file told apart.
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
