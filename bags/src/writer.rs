use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
    time::Duration,
};

use mcap::{WriteOptions, records::MessageHeader, write::NoSeek};
use wm_msgs::{Message, cdr};

use crate::{
    BagError, BagSummary, CDR, QosProfile, Schema, TopicSummary,
    metadata::{Metadata, Nanoseconds, SinceEpoch, TopicMetadata, TopicWithMessageCount},
    schema::canonical_type_name,
    type_schema,
};

/// Prefix of the keys in `custom_data` that hold the messages lost of each topic.
pub(crate) const LOST_PREFIX: &str = "lost_messages.";

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// None.
    None,
    /// Fast.
    Lz4,
    /// Smaller.
    #[default]
    Zstd,
}

impl Compression {
    const fn mcap(self) -> Option<mcap::Compression> {
        match self {
            Self::None => None,
            Self::Lz4 => Some(mcap::Compression::Lz4),
            Self::Zstd => Some(mcap::Compression::Zstd),
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Lz4 => "lz4",
            Self::Zstd => "zstd",
        }
    }
}

/// How a bag is written.
#[derive(Clone, Debug)]
pub struct WriterOptions {
    /// A chunk is closed and handed to the operating system when it holds this many bytes before compression. It is
    /// also the most that a killed process loses.
    pub chunk_size: u64,
    /// A chunk is also closed once it spans this much log time; a live recorder sets it, so that a slow topic is not
    /// held back for minutes.
    pub chunk_duration: Option<Duration>,
    /// Compression of the chunks.
    pub compression: Compression,
    /// The ROS distribution that `metadata.yaml` names; may be empty.
    pub ros_distro: String,
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self {
            chunk_size: WriteOptions::DEFAULT_CHUNK_SIZE,
            chunk_duration: None,
            compression: Compression::default(),
            ros_distro: String::new(),
        }
    }
}

/// A topic that is being written.
struct Channel {
    id: u16,
    type_name: String,
    qos_yaml: String,
    message_count: u64,
}

/// What the open chunk holds.
#[derive(Default)]
struct OpenChunk {
    bytes: u64,
    /// The first and the last log time, in ns.
    span: Option<(u64, u64)>,
}

/// Writes a bag: a directory `NAME` with `NAME_0.mcap` and, at [`finish`](Self::finish), `metadata.yaml`.
///
/// Each finished chunk is handed to the operating system at once. A writer that is dropped without `finish` leaves a
/// `.mcap` that can be read, and no `metadata.yaml`.
pub struct BagWriter {
    dir: PathBuf,
    file: PathBuf,
    options: WriterOptions,
    // `NoSeek`: the library then builds a chunk in memory and writes it in one go, so that a file never ends in a
    // chunk with an unfilled header.
    mcap: mcap::Writer<NoSeek<BufWriter<File>>>,
    channels: HashMap<String, Channel>,
    chunk: OpenChunk,
    /// The first and the last log time of the bag, in ns.
    span: Option<(u64, u64)>,
    message_count: u64,
    lost: BTreeMap<String, u64>,
}

impl BagWriter {
    /// Begins a bag at `dir`, which must not exist, or be an empty directory.
    ///
    /// # Errors
    /// Something is there already, or the file cannot be made.
    pub fn create(dir: impl AsRef<Path>, options: WriterOptions) -> Result<Self, BagError> {
        let dir = dir.as_ref().to_owned();
        let name = dir
            .file_name()
            .ok_or_else(|| BagError::NotABag {
                path: dir.clone(),
                reason: "expected a directory's name to write to".to_owned(),
            })?
            .to_string_lossy()
            .into_owned();
        fs::create_dir_all(&dir).map_err(|source| match source.kind() {
            std::io::ErrorKind::AlreadyExists => BagError::Exists(dir.clone()),
            _ => BagError::io(&dir, source),
        })?;
        let mut entries = fs::read_dir(&dir).map_err(|source| BagError::io(&dir, source))?;
        if entries.next().is_some() {
            return Err(BagError::Exists(dir));
        }
        let file = dir.join(format!("{name}_0.mcap"));
        let stream = File::create_new(&file).map_err(|source| BagError::io(&file, source))?;
        let mcap = WriteOptions::new()
            .profile("ros2")
            .library(concat!("wm_bag ", env!("CARGO_PKG_VERSION")))
            .compression(options.compression.mcap())
            // Fast zstd in this thread: images are JPEG already, and worker threads would outlive their use.
            .compression_level(1)
            .compression_threads(0)
            // Chunks are closed here, so that each is flushed.
            .chunk_size(None)
            .disable_seeking(true)
            .create(NoSeek::new(BufWriter::new(stream)))
            .map_err(|source| BagError::Mcap {
                path: file.clone(),
                source,
            })?;
        Ok(Self {
            dir,
            file,
            options,
            mcap,
            channels: HashMap::new(),
            chunk: OpenChunk::default(),
            span: None,
            message_count: 0,
            lost: BTreeMap::new(),
        })
    }

    /// The bag's directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.dir
    }

    /// Messages written so far.
    #[must_use]
    pub const fn message_count(&self) -> u64 {
        self.message_count
    }

    /// Adds a topic with the QoS that its publisher offers. Adding it again with the same type changes nothing.
    ///
    /// # Errors
    /// The topic has another type already, or a bad name; or the file cannot be written.
    pub fn add_topic<M: Message>(&mut self, topic: &str, qos: QosProfile) -> Result<(), BagError> {
        if self.known_channel(topic, &M::ros_name())?.is_some() {
            return Ok(());
        }
        self.add_topic_raw(topic, &M::ros_name(), &type_schema::<M>(), &qos.to_yaml())
    }

    /// Adds a topic of a type that is known by name only. `qos_yaml` is `offered_qos_profiles` of rosbag2
    /// ([`QosProfile::to_yaml`], or that of another bag). Adding it again with the same type changes nothing.
    ///
    /// # Errors
    /// The topic has another type already, or a bad name; or the file cannot be written.
    pub fn add_topic_raw(
        &mut self,
        topic: &str,
        type_name: &str,
        schema: &Schema,
        qos_yaml: &str,
    ) -> Result<(), BagError> {
        if self.known_channel(topic, type_name)?.is_some() {
            return Ok(());
        }
        if !topic.starts_with('/') || topic.len() < 2 {
            return Err(BagError::TopicName(topic.to_owned()));
        }
        let type_name = canonical_type_name(type_name)?;
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos_yaml.to_owned())]);
        let id = self
            .mcap
            .add_schema(&type_name, schema.encoding.as_str(), schema.text.as_bytes())
            .and_then(|schema_id| self.mcap.add_channel(schema_id, topic, CDR, &metadata))
            .map_err(|source| BagError::Mcap {
                path: self.file.clone(),
                source,
            })?;
        let channel = Channel {
            id,
            type_name,
            qos_yaml: qos_yaml.to_owned(),
            message_count: 0,
        };
        self.channels.insert(topic.to_owned(), channel);
        Ok(())
    }

    /// Writes a message. A new topic is added as reliable, volatile ([`QosProfile::reliable`]).
    ///
    /// # Errors
    /// See [`write_raw`](Self::write_raw).
    pub fn write<M: Message>(
        &mut self,
        topic: &str,
        message: &M,
        log_time_ns: u64,
    ) -> Result<(), BagError> {
        self.add_topic::<M>(topic, QosProfile::reliable())?;
        let data = cdr::to_bytes(message).map_err(|source| BagError::Cdr {
            topic: topic.to_owned(),
            source,
        })?;
        self.append(topic, &M::ros_name(), log_time_ns, &data)
    }

    /// Writes a message that is CDR already, header included; its bytes are stored untouched. A new topic is added
    /// with `schema` as reliable, volatile ([`QosProfile::reliable`]).
    ///
    /// # Errors
    /// The topic has another type, the bytes cannot be CDR, the time is past 2^63 - 1 ns, or the file cannot be
    /// written.
    pub fn write_raw(
        &mut self,
        topic: &str,
        type_name: &str,
        schema: &Schema,
        log_time_ns: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        self.add_topic_raw(topic, type_name, schema, &QosProfile::reliable().to_yaml())?;
        self.append(topic, type_name, log_time_ns, data)
    }

    /// Counts messages that were lost before they came here (a full queue), so that the bag says so.
    pub fn count_lost(&mut self, topic: &str, messages: u64) {
        if messages > 0 {
            *self.lost.entry(topic.to_owned()).or_default() += messages;
        }
    }

    /// Closes the open chunk and hands it to the operating system.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.chunk = OpenChunk::default();
        self.mcap.flush().map_err(|source| BagError::Mcap {
            path: self.file.clone(),
            source,
        })
    }

    /// Ends the bag: the last chunk, the summary, then, once the file is on the disk, `metadata.yaml`.
    ///
    /// # Errors
    /// The files cannot be written.
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.mcap.finish().map_err(|source| BagError::Mcap {
            path: self.file.clone(),
            source,
        })?;
        let stream = self
            .mcap
            .into_inner()
            .into_inner()
            .into_inner()
            .map_err(|error| BagError::io(&self.file, error.into_error()))?;
        stream
            .sync_all()
            .map_err(|source| BagError::io(&self.file, source))?;
        let size_bytes = stream
            .metadata()
            .map_err(|source| BagError::io(&self.file, source))?
            .len();

        let mut channels: Vec<(String, Channel)> = self.channels.into_iter().collect();
        channels.sort_by(|(a, _), (b, _)| a.cmp(b));
        let (start_ns, end_ns) = self.span.unwrap_or((0, 0));
        let file_name = self.file.file_name().map(PathBuf::from).unwrap_or_default();
        let mut metadata = Metadata::of_file(
            &file_name,
            SinceEpoch {
                nanoseconds_since_epoch: signed(start_ns),
            },
            Nanoseconds {
                nanoseconds: signed(end_ns - start_ns),
            },
            self.message_count,
        );
        metadata.ros_distro.clone_from(&self.options.ros_distro);
        if !self.lost.is_empty() {
            let entries = self
                .lost
                .iter()
                .map(|(topic, count)| (format!("{LOST_PREFIX}{topic}"), count.to_string()));
            metadata.custom_data = Some(entries.collect());
        }
        metadata.topics_with_message_count = channels
            .iter()
            .map(|(name, channel)| TopicWithMessageCount {
                topic_metadata: TopicMetadata {
                    name: name.clone(),
                    type_name: channel.type_name.clone(),
                    serialization_format: CDR.to_owned(),
                    // Text that is no YAML stays text, the form of older versions.
                    offered_qos_profiles: serde_yaml_ng::from_str(&channel.qos_yaml)
                        .unwrap_or_else(|_| channel.qos_yaml.clone().into()),
                    type_description_hash: String::new(),
                },
                message_count: channel.message_count,
            })
            .collect();
        metadata.write(&self.dir)?;

        Ok(BagSummary {
            path: self.dir,
            files: vec![self.file],
            size_bytes,
            start_ns,
            end_ns,
            message_count: self.message_count,
            topics: channels
                .into_iter()
                .map(|(name, channel)| TopicSummary {
                    name,
                    type_name: channel.type_name,
                    serialization_format: CDR.to_owned(),
                    message_count: channel.message_count,
                })
                .collect(),
            lost: self.lost,
            compression: self.options.compression.name().to_owned(),
            ros_distro: self.options.ros_distro,
            warnings: Vec::new(),
        })
    }

    /// The topic's channel if it is known, held against the type.
    fn known_channel(
        &mut self,
        topic: &str,
        type_name: &str,
    ) -> Result<Option<&mut Channel>, BagError> {
        let Some(channel) = self.channels.get_mut(topic) else {
            return Ok(None);
        };
        if channel.type_name != type_name && channel.type_name != canonical_type_name(type_name)? {
            return Err(BagError::TypeConflict {
                path: self.dir.clone(),
                topic: topic.to_owned(),
                first: channel.type_name.clone(),
                second: type_name.to_owned(),
            });
        }
        Ok(Some(channel))
    }

    /// Writes to a topic that has been added.
    fn append(
        &mut self,
        topic: &str,
        type_name: &str,
        log_time_ns: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        if i64::try_from(log_time_ns).is_err() {
            return Err(BagError::LogTime {
                topic: topic.to_owned(),
                log_time_ns,
            });
        }
        if data.len() < 4 {
            return Err(BagError::NotCdr {
                topic: topic.to_owned(),
                len: data.len(),
            });
        }
        let Some(channel) = self.known_channel(topic, type_name)? else {
            return Err(BagError::TopicName(topic.to_owned()));
        };
        channel.message_count += 1;
        let header = MessageHeader {
            channel_id: channel.id,
            // MCAP's sequence is 32 bits wide and may wrap.
            sequence: channel.message_count as u32,
            log_time: log_time_ns,
            publish_time: log_time_ns,
        };
        self.mcap
            .write_to_known_channel(&header, data)
            .map_err(|source| BagError::Mcap {
                path: self.file.clone(),
                source,
            })?;
        self.message_count += 1;
        self.span = Some(widened(self.span, log_time_ns));
        let (chunk_start_ns, chunk_end_ns) = widened(self.chunk.span, log_time_ns);
        self.chunk.span = Some((chunk_start_ns, chunk_end_ns));
        self.chunk.bytes += data.len() as u64;
        let spans_enough = self
            .options
            .chunk_duration
            .is_some_and(|most| Duration::from_nanos(chunk_end_ns - chunk_start_ns) >= most);
        if self.chunk.bytes >= self.options.chunk_size || spans_enough {
            self.flush()?;
        }
        Ok(())
    }
}

/// A span of time that takes in one more time.
fn widened(span: Option<(u64, u64)>, time_ns: u64) -> (u64, u64) {
    span.map_or((time_ns, time_ns), |(start, end)| {
        (start.min(time_ns), end.max(time_ns))
    })
}

/// Log times are held to 2^63 - 1 when they are written, so that nothing saturates here.
fn signed(time_ns: u64) -> i64 {
    i64::try_from(time_ns).unwrap_or(i64::MAX)
}
