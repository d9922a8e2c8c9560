use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::Summary;

use crate::{BagError, CDR, Schema, TopicInfo, schema::canonical_type_name};

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
            segments: Vec::new(),
            span: None,
            compressions: BTreeSet::new(),
        }
    }

    /// Takes channels, chunks and counts over from a file's summary.
    pub fn take_summary(&mut self, summary: &Summary) -> Result<(), BagError> {
        // One copy of a definition, however many channels have it.
        let mut schemas: HashMap<u16, Arc<Schema>> = HashMap::new();
        for channel in summary.channels.values() {
            let schema = channel.schema.as_ref().map(|schema| {
                let shared = schemas.entry(schema.id).or_insert_with(|| {
                    Arc::new(Schema {
                        encoding: schema.encoding.as_str().into(),
                        text: String::from_utf8_lossy(&schema.data).into_owned(),
                    })
                });
                (schema.name.as_str(), Arc::clone(shared))
            });
            self.add_channel(
                channel.id,
                &channel.topic,
                &channel.message_encoding,
                channel
                    .metadata
                    .get("offered_qos_profiles")
                    .map_or("", String::as_str),
                schema,
            )?;
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
    pub fn add_channel(
        &mut self,
        id: u16,
        topic: &str,
        encoding: &str,
        qos_yaml: &str,
        schema: Option<(&str, Arc<Schema>)>,
    ) -> Result<(), BagError> {
        if self.channels.contains_key(&id) {
            return Ok(());
        }
        if encoding != CDR {
            return Err(BagError::MessageEncoding {
                path: self.path.clone(),
                topic: topic.to_owned(),
                encoding: encoding.to_owned(),
            });
        }
        let Some((schema_name, schema)) = schema else {
            return Err(BagError::NoType {
                path: self.path.clone(),
                topic: topic.to_owned(),
            });
        };
        let type_name = canonical_type_name(schema_name).map_err(|_| BagError::SchemaName {
            path: self.path.clone(),
            topic: topic.to_owned(),
            name: schema_name.to_owned(),
        })?;
        self.channels.insert(
            id,
            TopicInfo {
                name: topic.into(),
                type_name: type_name.into(),
                schema,
                qos_yaml: qos_yaml.into(),
                message_count: 0,
            },
        );
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
