use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::Summary;

use crate::{
    BagError, CDR, QOS_KEY, Schema, TYPE_HASH_KEY, TopicInfo, schema::canonical_type_name,
};

/// A part of a file that is read in one go.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub offset: u64,
    pub length: u64,
    /// Log times of the first and the last message, in ns.
    pub start_ns: u64,
    pub end_ns: u64,
}

/// Where the messages of one MCAP file are, and what its channels are.
#[derive(Debug)]
pub(super) struct FileIndex {
    pub path: PathBuf,
    pub size_bytes: u64,
    /// By channel id; several channels may share a topic.
    pub channels: BTreeMap<u16, TopicInfo>,
    /// The same channels as the file defines them, for who copies them.
    pub definitions: BTreeMap<u16, Arc<mcap::Channel<'static>>>,
    /// The text of each schema, by its id.
    schemas: HashMap<u16, Arc<Schema>>,
    pub segments: Vec<Segment>,
    /// The first and the last log time, in ns.
    pub span: Option<(u64, u64)>,
    /// Compressions of the chunks, as MCAP names them.
    pub compressions: BTreeSet<String>,
}

impl FileIndex {
    /// The index of a file that nothing is known of yet.
    pub fn empty(path: &Path, size_bytes: u64) -> Self {
        Self {
            path: path.to_owned(),
            size_bytes,
            channels: BTreeMap::new(),
            definitions: BTreeMap::new(),
            schemas: HashMap::new(),
            segments: Vec::new(),
            span: None,
            compressions: BTreeSet::new(),
        }
    }

    /// Takes channels, chunks and counts over from a file's summary.
    pub fn take_summary(&mut self, summary: &Summary) -> Result<(), BagError> {
        for channel in summary.channels.values() {
            self.add_channel(channel)?;
        }
        for chunk in &summary.chunk_indexes {
            self.compressions.insert(chunk.compression.clone());
            self.segments.push(Segment {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                start_ns: chunk.message_start_time,
                end_ns: chunk.message_end_time,
            });
        }
        if let Some(stats) = summary
            .stats
            .as_ref()
            .filter(|stats| stats.message_count > 0)
        {
            self.span = Some((stats.message_start_time, stats.message_end_time));
            for (id, count) in &stats.channel_message_counts {
                if let Some(channel) = self.channels.get_mut(id) {
                    channel.message_count = *count;
                }
            }
        }
        Ok(())
    }

    /// Adds a channel, held against what this crate reads.
    pub fn add_channel(&mut self, channel: &Arc<mcap::Channel<'static>>) -> Result<(), BagError> {
        if self.channels.contains_key(&channel.id) {
            return Ok(());
        }
        if channel.message_encoding != CDR {
            return Err(BagError::MessageEncoding {
                path: self.path.clone(),
                topic: channel.topic.clone(),
                encoding: channel.message_encoding.clone(),
            });
        }
        let Some(schema) = &channel.schema else {
            return Err(BagError::NoType {
                path: self.path.clone(),
                topic: channel.topic.clone(),
            });
        };
        let type_name = canonical_type_name(&schema.name).map_err(|_| BagError::SchemaName {
            path: self.path.clone(),
            topic: channel.topic.clone(),
            name: schema.name.clone(),
        })?;
        // One copy of a definition, however many channels have it.
        let shared = self.schemas.entry(schema.id).or_insert_with(|| {
            Arc::new(Schema {
                encoding: schema.encoding.as_str().into(),
                text: String::from_utf8_lossy(&schema.data).into_owned(),
            })
        });
        let text = |key| channel.metadata.get(key).map_or("", String::as_str).into();
        self.channels.insert(
            channel.id,
            TopicInfo {
                name: channel.topic.as_str().into(),
                type_name: type_name.into(),
                schema: Arc::clone(shared),
                qos_yaml: text(QOS_KEY),
                type_hash: text(TYPE_HASH_KEY),
                message_count: 0,
            },
        );
        self.definitions.insert(channel.id, Arc::clone(channel));
        Ok(())
    }

    /// Counts a message that a scan has met.
    pub fn count(&mut self, channel_id: u16, log_time_ns: u64) {
        if let Some(channel) = self.channels.get_mut(&channel_id) {
            channel.message_count += 1;
            let (start, end) = self.span.unwrap_or((log_time_ns, log_time_ns));
            self.span = Some((start.min(log_time_ns), end.max(log_time_ns)));
        }
    }
}
