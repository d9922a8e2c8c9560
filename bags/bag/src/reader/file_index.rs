use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    path::Path,
    sync::Arc,
};

use super::{
    passes::{ChannelTimes, Passes},
    stored_file::StoredFile,
    times::Times,
};
use crate::{
    BagWarning, MessageEncoding, QOS_KEY, Schema, TYPE_HASH_KEY, TopicInfo,
    decoding::Decoding,
    schema::{absolute, with_absolute_name},
};

/// A part of a file that is read at once.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    pub place: SegmentPlace,
    /// Log times of the earliest and the latest message \[ns\].
    pub start_ns: u64,
    pub end_ns: u64,
    /// The channels of its messages; `None` if unknown.
    pub channels: Option<Box<[u16]>>,
}

/// The place of a segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum SegmentPlace {
    /// Bytes of an MCAP file: a chunk, or messages outside chunks.
    Bytes { offset: u64, length: u64 },
    /// Rows of an sqlite3 file, by their ids.
    Rows { first: i64, last: i64 },
}

impl SegmentPlace {
    /// The place in errors: the first byte or row.
    pub fn offset(self) -> u64 {
        match self {
            Self::Bytes { offset, .. } => offset,
            // Negative row ids are valid in sqlite3; errors show 0.
            Self::Rows { first, .. } => u64::try_from(first).unwrap_or(0),
        }
    }
}

/// A channel whose messages are read.
#[derive(Clone, Debug)]
pub(super) struct Channel {
    pub topic: TopicInfo,
    pub decoding: Arc<Decoding>,
    pub is_latched: bool,
    pub times: ChannelTimes,
}

/// A channel that is skipped.
#[derive(Clone, Debug)]
pub(super) struct SkippedChannel {
    pub topic: String,
    pub reason: String,
    pub messages: u64,
}

/// The channels of one file, and the places of their messages.
#[derive(Debug)]
pub(super) struct FileIndex {
    pub file: StoredFile,
    pub size_bytes: u64,
    /// By channel id; several channels may share a topic.
    pub channels: BTreeMap<u16, Channel>,
    /// Unreadable channels, by channel id.
    pub skipped: BTreeMap<u16, SkippedChannel>,
    /// Number of messages of undefined channels, by channel id.
    undefined: BTreeMap<u16, u64>,
    /// The read_topic channels as the file defines them, for copies.
    pub definitions: BTreeMap<u16, Arc<mcap::Channel<'static>>>,
    /// The text of each schema, by its id.
    schemas: HashMap<u16, Arc<Schema>>,
    pub segments: Vec<Segment>,
    /// First and last log time \[ns\].
    pub span: Option<(u64, u64)>,
    pub times: Times,
    pub passes: Passes,
    /// Compressions of the chunks, as MCAP names them.
    pub compressions: BTreeSet<String>,
    /// `mcap` or `sqlite3`.
    pub storage: &'static str,
}

impl FileIndex {
    /// An index without contents.
    pub fn empty(file: &StoredFile, size_bytes: u64, storage: &'static str) -> Self {
        Self {
            file: file.clone(),
            size_bytes,
            channels: BTreeMap::new(),
            skipped: BTreeMap::new(),
            undefined: BTreeMap::new(),
            definitions: BTreeMap::new(),
            schemas: HashMap::new(),
            segments: Vec::new(),
            span: None,
            times: Times::default(),
            passes: Passes::default(),
            compressions: BTreeSet::new(),
            storage,
        }
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.file.path
    }

    /// Adds a channel; an unreadable one is skipped and named.
    pub fn add_channel(&mut self, channel: &Arc<mcap::Channel<'static>>) {
        let id = channel.id;
        if self.channels.contains_key(&id) || self.skipped.contains_key(&id) {
            return;
        }
        // A definition may come after its first messages.
        let earlier = self.undefined.remove(&id).unwrap_or(0);
        match self.read_topic(channel) {
            Ok(mut topic) => {
                topic.message_count = earlier;
                let decoding = Arc::new(Decoding::new(&topic.type_name, &topic.schema));
                let is_latched = topic.is_latched();
                let read_topic = Channel {
                    topic,
                    decoding,
                    is_latched,
                    times: ChannelTimes::default(),
                };
                self.channels.insert(id, read_topic);
                self.definitions.insert(id, with_absolute_name(channel));
            }
            Err(reason) => {
                self.skip(id, &channel.topic, reason);
                if let Some(skipped) = self.skipped.get_mut(&id) {
                    skipped.messages = earlier;
                }
            }
        }
    }

    /// Removes a channel and names the reason.
    pub fn skip(&mut self, id: u16, topic: &str, reason: String) {
        self.definitions.remove(&id);
        let known = self.channels.remove(&id);
        let skipped = SkippedChannel {
            topic: topic.to_owned(),
            reason,
            messages: known.map_or(0, |channel| channel.topic.message_count),
        };
        self.skipped.insert(id, skipped);
    }

    /// The channel's topic.
    ///
    /// # Errors
    /// The reason why its messages cannot be read.
    fn read_topic(&mut self, channel: &mcap::Channel<'static>) -> Result<TopicInfo, String> {
        let schema = channel.schema.as_ref();
        let name = schema.map(|schema| schema.name.as_str());
        let (encoding, type_name) = MessageEncoding::of_channel(&channel.message_encoding, name)?;
        let (id, schema_encoding, data) = schema.map_or((0, "", &[][..]), |schema| {
            (schema.id, schema.encoding.as_str(), &*schema.data)
        });
        // Channels of the same type share one copy of the definition.
        let shared = self.schemas.entry(id).or_insert_with(|| {
            let text = match encoding {
                MessageEncoding::Cdr => String::from_utf8_lossy(data).into_owned(),
                MessageEncoding::Protobuf => String::new(),
            };
            Arc::new(Schema {
                encoding: schema_encoding.into(),
                text,
            })
        });
        let text = |key| channel.metadata.get(key).map_or("", String::as_str).into();
        Ok(TopicInfo {
            name: absolute(&channel.topic).into(),
            type_name: type_name.into(),
            encoding,
            schema: Arc::clone(shared),
            qos_yaml: text(QOS_KEY),
            type_hash: text(TYPE_HASH_KEY),
            message_count: 0,
        })
    }

    /// Counts the next message of the file.
    pub fn count(&mut self, channel_id: u16, log_time_ns: u64) {
        if let Some(channel) = self.channels.get_mut(&channel_id) {
            channel.topic.message_count += 1;
            let (start, end) = self.span.unwrap_or((log_time_ns, log_time_ns));
            self.span = Some((start.min(log_time_ns), end.max(log_time_ns)));
            self.times.push(log_time_ns);
            if !channel.is_latched {
                self.passes.take(&mut channel.times, log_time_ns);
            }
        } else if let Some(skipped) = self.skipped.get_mut(&channel_id) {
            skipped.messages += 1;
        } else {
            *self.undefined.entry(channel_id).or_default() += 1;
        }
    }

    /// Warnings about channels.
    pub fn channel_warnings(&self) -> impl Iterator<Item = BagWarning> + '_ {
        let skipped = self
            .skipped
            .values()
            .map(|skipped| BagWarning::ChannelSkipped {
                file: self.path().to_owned(),
                topic: skipped.topic.clone(),
                messages: skipped.messages,
                reason: skipped.reason.clone(),
            });
        let fields = self.channels.values().filter_map(|channel| {
            let topic = &channel.topic;
            BagWarning::of_fields(&topic.name, &topic.type_name, channel.decoding.fields()?)
        });
        let undefined = self
            .undefined
            .iter()
            .map(|(id, messages)| BagWarning::ChannelSkipped {
                file: self.path().to_owned(),
                topic: format!("number {id}"),
                messages: *messages,
                reason: "the file does not define it".to_owned(),
            });
        skipped.chain(undefined).chain(fields)
    }
}
