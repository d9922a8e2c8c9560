mod file;
mod options;

use std::{
    borrow::Cow,
    collections::{BTreeMap, HashMap},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use bytes::Bytes;
use mcap::records::MessageHeader;
use wm_msgs::{Message, cdr};

use crate::{
    BagError, BagSummary, Durability, LatchedMessages, MessageEncoding, QOS_KEY, QosProfile,
    Schema, TYPE_HASH_KEY, TopicSummary, known_qos,
    metadata::{
        FileInformation, Metadata, Nanoseconds, SinceEpoch, TopicMetadata, TopicWithMessageCount,
    },
    reader::times::{Times, find_main_part},
    schema::{canonical_type_name, with_absolute_name},
    type_schema,
};
use file::{BagFile, WrittenFile};
pub use options::{Compression, StoragePreset, WriterOptions};

/// Prefix of the keys in `custom_data` with the lost messages of a topic.
pub(crate) const LOST_PREFIX: &str = "lost_messages.";
/// Prefix of the keys in `custom_data` with the number of messages of a topic that later files repeat.
pub(crate) const REPEATED_PREFIX: &str = "wm.repeated_messages.";

/// A channel of the bag; in a copied bag, several may share a topic.
struct Channel {
    definition: Arc<mcap::Channel<'static>>,
    /// The type, as `package/msg/Type`.
    type_name: String,
    message_count: u64,
    is_latched: bool,
    /// Number of messages that later files repeat.
    repeated: u64,
}

/// A latched message, repeated at the start of the next file.
struct LatchedCopy {
    /// Index of its channel.
    number: usize,
    header: MessageHeader,
    data: Bytes,
}

/// Writes a bag: a folder `NAME` with `NAME_0.mcap` and, after [`finish`](Self::finish), `metadata.yaml`. With a limit of
/// size or duration in the options, `NAME_1.mcap` and so on follow, each with every topic.
///
/// Each finished chunk is passed to the operating system at once. A writer that is dropped without `finish` leaves a
/// readable `.mcap` and no `metadata.yaml`.
pub struct BagWriter {
    dir: PathBuf,
    name: String,
    options: WriterOptions,
    file: BagFile,
    written: Vec<WrittenFile>,
    channels: Vec<Channel>,
    /// Index of each topic's first channel.
    by_topic: HashMap<String, usize>,
    /// Index of each topic's channel without a definition.
    undefined: HashMap<String, usize>,
    latched: LatchedMessages<LatchedCopy>,
    /// Whether the file is new and still lacks the latched messages.
    is_new_file: bool,
    times: Times,
    message_count: u64,
    lost: BTreeMap<String, u64>,
    notes: BTreeMap<String, String>,
}

impl BagWriter {
    /// Creates a bag at `dir`, which must be missing or an empty folder.
    ///
    /// # Errors
    /// `dir` exists and is not an empty folder, or the file cannot be created.
    pub fn create(dir: impl AsRef<Path>, options: WriterOptions) -> Result<Self, BagError> {
        let dir = dir.as_ref().to_owned();
        let name = dir
            .file_name()
            .ok_or_else(|| BagError::NotABag {
                path: dir.clone(),
                reason: "expected the path of a directory to write to".to_owned(),
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
        let file = BagFile::create(dir.join(format!("{name}_0.mcap")), &options)?;
        Ok(Self {
            dir,
            name,
            options,
            file,
            written: Vec::new(),
            channels: Vec::new(),
            by_topic: HashMap::new(),
            undefined: HashMap::new(),
            latched: LatchedMessages::default(),
            is_new_file: false,
            times: Times::default(),
            message_count: 0,
            lost: BTreeMap::new(),
            notes: BTreeMap::new(),
        })
    }

    /// Adds or replaces a note about the bag in `custom_data` of `metadata.yaml`, as `ros2 bag record --custom-data` does.
    pub fn note(&mut self, key: &str, value: impl Into<String>) {
        self.notes.insert(key.to_owned(), value.into());
    }

    /// The bag's folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.dir
    }

    /// Messages written so far.
    #[must_use]
    pub const fn message_count(&self) -> u64 {
        self.message_count
    }

    /// Adds a topic with its publisher's QoS. Adding it again with the same type has no effect.
    ///
    /// # Errors
    /// The topic has another type already, or a bad name; or the file cannot be written.
    pub fn add_topic<M: Message>(&mut self, topic: &str, qos: QosProfile) -> Result<(), BagError> {
        if self.known_channel(topic, &M::ros_name())?.is_some() {
            return Ok(());
        }
        self.add_topic_raw(topic, &M::ros_name(), &type_schema::<M>(), &qos.to_yaml())
    }

    /// Adds a topic by the name of its type. `qos_yaml` is the text of `offered_qos_profiles` ([`QosProfile::to_yaml`], or from
    /// another bag). Adding it again with the same type has no effect.
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
        // Types with an unknown or invalid definition are recorded too, as by rosbag2.
        let type_hash = match schema.type_hash(&type_name) {
            Ok(Some(hash)) => hash.to_string(),
            Ok(None) | Err(_) => String::new(),
        };
        let schema = mcap::Schema {
            // Each file assigns its own ids.
            id: 0,
            name: type_name,
            encoding: schema.encoding.as_str().to_owned(),
            data: Cow::Owned(schema.text.as_bytes().to_vec()),
        };
        let channel = mcap::Channel {
            id: 0,
            topic: topic.to_owned(),
            schema: Some(Arc::new(schema)),
            message_encoding: MessageEncoding::Cdr.as_str().to_owned(),
            metadata: BTreeMap::from([
                (QOS_KEY.to_owned(), qos_yaml.to_owned()),
                (TYPE_HASH_KEY.to_owned(), type_hash),
            ]),
        };
        self.add_channel(Arc::new(channel)).map(|_| ())
    }

    /// Adds a channel of another file; returns its index for [`copy`](Self::copy).
    ///
    /// # Errors
    /// The topic has another type already, or no type; or the file cannot be written.
    pub(crate) fn add_channel(
        &mut self,
        definition: Arc<mcap::Channel<'static>>,
    ) -> Result<usize, BagError> {
        let definition = with_absolute_name(&definition);
        let name = definition
            .schema
            .as_ref()
            .map(|schema| schema.name.as_str());
        let name = name.ok_or_else(|| BagError::NoType {
            path: self.dir.clone(),
            topic: definition.topic.clone(),
        })?;
        let is_protobuf = definition.message_encoding == MessageEncoding::Protobuf.as_str();
        let type_name = match is_protobuf {
            true => name.to_owned(),
            false => canonical_type_name(name)?,
        };
        self.known_channel(&definition.topic, &type_name)?;
        self.file.add(&definition)?;
        let number = self.channels.len();
        self.by_topic
            .entry(definition.topic.clone())
            .or_insert(number);
        let qos = definition.metadata.get(QOS_KEY);
        let is_latched = is_latched(&definition.topic, qos.map_or("", String::as_str));
        self.channels.push(Channel {
            definition,
            type_name,
            message_count: 0,
            is_latched,
            repeated: 0,
        });
        Ok(number)
    }

    /// Writes a message. A new topic gets the QoS [`QosProfile::reliable`].
    pub fn write<M: Message>(
        &mut self,
        topic: &str,
        message: &M,
        log_time_ns: u64,
    ) -> Result<(), BagError> {
        self.add_topic::<M>(topic, QosProfile::reliable())?;
        let data = cdr::to_bytes(message).map_err(|reason| BagError::Cdr {
            topic: topic.to_owned(),
            reason,
        })?;
        self.append(topic, &M::ros_name(), log_time_ns, &data)
    }

    /// Writes a message in CDR, with its header, unchanged. A new topic gets `schema` and the QoS [`QosProfile::reliable`].
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

    /// Writes a message of unknown definition to a topic that has a definition: on a separate channel with the topic's type and
    /// QoS, so that the bag claims no wrong definition.
    ///
    /// # Errors
    /// The topic has not been added, the bytes cannot be CDR, the time is past 2^63 - 1 ns, or the file cannot be written.
    pub fn write_undefined(
        &mut self,
        topic: &str,
        log_time_ns: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        let number = match self.undefined.get(topic) {
            Some(number) => *number,
            None => {
                let known = self.by_topic.get(topic).and_then(|n| self.channels.get(*n));
                let known = known.ok_or_else(|| BagError::TopicName(topic.to_owned()))?;
                let mut definition = mcap::Channel::clone(&known.definition);
                definition.metadata.remove(TYPE_HASH_KEY);
                definition.schema = Some(Arc::new(mcap::Schema {
                    id: 0,
                    name: known.type_name.clone(),
                    encoding: String::new(),
                    data: Cow::Owned(Vec::new()),
                }));
                let number = self.add_channel(Arc::new(definition))?;
                self.undefined.insert(topic.to_owned(), number);
                number
            }
        };
        self.append_to(number, topic, (log_time_ns, log_time_ns), data)
    }

    /// Counts messages that were lost before this writer, for example in a full queue.
    pub fn count_lost(&mut self, topic: &str, messages: u64) {
        if messages > 0 {
            *self.lost.entry(topic.to_owned()).or_default() += messages;
        }
    }

    /// Closes the open chunk and passes it to the operating system.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.file.flush()
    }

    /// Writes the last chunk and the summary and, once the file is on the disk, `metadata.yaml`.
    ///
    /// # Errors
    /// The files cannot be written.
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.written.push(self.file.finish()?);
        let span = self.written.iter().filter_map(|file| file.span).reduce(
            |(start, end), (next_start, next_end)| (start.min(next_start), end.max(next_end)),
        );
        // As rosbag2, an empty bag has the time 0.
        let (start_ns, end_ns) = span.unwrap_or((0, 0));
        let main = find_main_part(&self.times.stretches());
        let mut topics: BTreeMap<&str, TopicWithMessageCount> = BTreeMap::new();
        for channel in &self.channels {
            topics
                .entry(channel.definition.topic.as_str())
                .and_modify(|topic| topic.message_count += channel.message_count)
                .or_insert_with(|| describe_topic(channel));
        }
        let mut metadata = Metadata::of_files(self.written.iter().map(describe_file).collect());
        metadata.ros_distro.clone_from(&self.options.ros_distro);
        let mut notes = self.notes.clone();
        for channel in self.channels.iter().filter(|channel| channel.repeated > 0) {
            let key = format!("{REPEATED_PREFIX}{}", channel.definition.topic);
            notes.insert(key, channel.repeated.to_string());
        }
        let losses = self.lost.iter();
        notes.extend(
            losses.map(|(topic, count)| (format!("{LOST_PREFIX}{topic}"), count.to_string())),
        );
        metadata.custom_data = (!notes.is_empty()).then_some(notes);
        let repeated = |topic: &str| -> u64 {
            let channels = self.channels.iter();
            let of_topic = channels.filter(|channel| channel.definition.topic == topic);
            of_topic.map(|channel| channel.repeated).sum()
        };
        let summaries = topics.values().map(|topic| TopicSummary {
            name: topic.topic_metadata.name.clone(),
            type_name: topic.topic_metadata.type_name.clone(),
            serialization_format: topic.topic_metadata.serialization_format.clone(),
            message_count: topic.message_count - repeated(&topic.topic_metadata.name),
        });
        let summaries = summaries.collect();
        metadata.topics_with_message_count = topics.into_values().collect();
        metadata.write(&self.dir)?;

        Ok(BagSummary {
            path: self.dir,
            size_bytes: self.written.iter().map(|file| file.size_bytes).sum(),
            files: self.written.into_iter().map(|file| file.path).collect(),
            start_ns,
            end_ns,
            main_span_ns: main.map(|(part, _)| (part.start_ns, part.end_ns)),
            storage: "mcap".to_owned(),
            message_count: self.message_count,
            topics: summaries,
            lost: self.lost,
            compression: self.options.chunk_compression().name().to_owned(),
            ros_distro: self.options.ros_distro,
            notes: self.notes,
            warnings: Vec::new(),
        })
    }

    /// The index of the topic's channel, if it exists; checks its type.
    fn known_channel(&self, topic: &str, type_name: &str) -> Result<Option<usize>, BagError> {
        let number = self.by_topic.get(topic).copied();
        let Some((number, known)) = number.and_then(|n| Some((n, self.channels.get(n)?))) else {
            return Ok(None);
        };
        let is_same = |name: String| known.type_name == name;
        if known.type_name != type_name && !canonical_type_name(type_name).is_ok_and(is_same) {
            return Err(BagError::TypeConflict {
                path: self.dir.clone(),
                topic: topic.to_owned(),
                first: known.type_name.clone(),
                second: type_name.to_owned(),
            });
        }
        Ok(Some(number))
    }

    fn append(
        &mut self,
        topic: &str,
        type_name: &str,
        log_time_ns: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        let known = self.known_channel(topic, type_name)?;
        let number = known.ok_or_else(|| BagError::TopicName(topic.to_owned()))?;
        self.append_to(number, topic, (log_time_ns, log_time_ns), data)
    }

    /// Writes to an existing topic, with these log and publish times \[ns\].
    pub(crate) fn append_at(
        &mut self,
        topic: &str,
        times_ns: (u64, u64),
        data: &[u8],
    ) -> Result<(), BagError> {
        let known = self.by_topic.get(topic).copied();
        let number = known.ok_or_else(|| BagError::TopicName(topic.to_owned()))?;
        self.append_to(number, topic, times_ns, data)
    }

    /// Writes to the channel with this index, with these log and publish times \[ns\].
    fn append_to(
        &mut self,
        number: usize,
        topic: &str,
        (log_time_ns, publish_time_ns): (u64, u64),
        data: &[u8],
    ) -> Result<(), BagError> {
        if data.len() < 4 {
            return Err(BagError::NotCdr {
                topic: topic.to_owned(),
                len: data.len(),
            });
        }
        let Some(channel) = self.channels.get(number) else {
            return Err(BagError::TopicName(topic.to_owned()));
        };
        let header = MessageHeader {
            channel_id: 0,
            // Wraps: sequence numbers of MCAP have 32 bits.
            sequence: (channel.message_count - channel.repeated + 1) as u32,
            log_time: log_time_ns,
            publish_time: publish_time_ns,
        };
        self.copy(number, header, data)
    }

    /// Writes an unchanged message to the channel with this index, with the times and sequence number of `header`.
    ///
    /// # Errors
    /// The time is past 2^63 - 1 ns, or the file cannot be written.
    pub(crate) fn copy(
        &mut self,
        number: usize,
        header: MessageHeader,
        data: &[u8],
    ) -> Result<(), BagError> {
        let Some(channel) = self.channels.get(number) else {
            return Ok(());
        };
        if i64::try_from(header.log_time).is_err() {
            return Err(BagError::LogTime {
                topic: channel.definition.topic.clone(),
                log_time_ns: header.log_time,
            });
        }
        if self.file.is_full(header.log_time, &self.options)? {
            self.split()?;
        }
        if std::mem::take(&mut self.is_new_file) && self.options.repeats_latched {
            self.repeat_latched(header.log_time)?;
        }
        self.file.write(number, header, data, &self.options)?;
        if let Some(channel) = self.channels.get_mut(number) {
            channel.message_count += 1;
            if channel.is_latched {
                let topic = channel.definition.topic.as_str().into();
                let data = Bytes::copy_from_slice(data);
                let latched = LatchedCopy {
                    number,
                    header,
                    data: data.clone(),
                };
                self.latched.add(&topic, &data, latched);
            }
        }
        self.message_count += 1;
        self.times.push(header.log_time);
        Ok(())
    }

    /// Repeats the latched messages with this log time; their publish times stay.
    fn repeat_latched(&mut self, log_time_ns: u64) -> Result<(), BagError> {
        for (_, latched) in self.latched.iter() {
            let mut header = latched.header;
            header.log_time = log_time_ns;
            self.file
                .write(latched.number, header, &latched.data, &self.options)?;
            if let Some(channel) = self.channels.get_mut(latched.number) {
                channel.message_count += 1;
                channel.repeated += 1;
            }
        }
        Ok(())
    }

    /// Continues in a new file with all channels, which can be read by itself.
    ///
    /// # Errors
    /// The files cannot be written.
    pub fn split(&mut self) -> Result<(), BagError> {
        let number = self.written.len() + 1;
        let path = self.dir.join(format!("{}_{number}.mcap", self.name));
        let mut next = BagFile::create(path, &self.options)?;
        for channel in &self.channels {
            next.add(&channel.definition)?;
        }
        let full = std::mem::replace(&mut self.file, next);
        self.written.push(full.finish()?);
        self.is_new_file = true;
        Ok(())
    }
}

/// Whether a topic with these profiles is latched; without a valid profile, by its name.
fn is_latched(topic: &str, qos_yaml: &str) -> bool {
    // An invalid profile counts as a missing one.
    let profiles = QosProfile::parse_yaml(qos_yaml).unwrap_or_default();
    let profile = profiles.into_iter().next().or_else(|| known_qos(topic));
    profile.is_some_and(|qos| qos.durability == Durability::TransientLocal)
}

fn describe_topic(channel: &Channel) -> TopicWithMessageCount {
    // Channels of other recorders may lack both keys; rosbag2 then writes empty values.
    let metadata = |key: &str| channel.definition.metadata.get(key).cloned();
    let qos_yaml = metadata(QOS_KEY).unwrap_or_default();
    TopicWithMessageCount {
        topic_metadata: TopicMetadata {
            name: channel.definition.topic.clone(),
            type_name: channel.type_name.clone(),
            serialization_format: channel.definition.message_encoding.clone(),
            // Invalid YAML is kept as text, the form of older versions.
            offered_qos_profiles: serde_yaml_ng::from_str(&qos_yaml)
                .unwrap_or_else(|_| qos_yaml.into()),
            // The key that rosbag2's recorder uses.
            type_description_hash: metadata(TYPE_HASH_KEY).unwrap_or_default(),
        },
        message_count: channel.message_count,
    }
}

fn describe_file(file: &WrittenFile) -> FileInformation {
    // As rosbag2, an empty file has the time 0.
    let (start_ns, end_ns) = file.span.unwrap_or((0, 0));
    FileInformation {
        // Never empty: the writer named the file itself.
        path: file.path.file_name().map(PathBuf::from).unwrap_or_default(),
        starting_time: SinceEpoch {
            nanoseconds_since_epoch: signed(start_ns),
        },
        duration: Nanoseconds {
            nanoseconds: signed(end_ns - start_ns),
        },
        message_count: file.message_count,
    }
}

/// Never saturates: log times are limited to 2^63 - 1 when they are written.
fn signed(time_ns: u64) -> i64 {
    i64::try_from(time_ns).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
