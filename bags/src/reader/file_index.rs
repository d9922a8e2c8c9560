use std::{
    collections::{BTreeSet, HashMap},
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
};

use mcap::{
    MAGIC, Summary,
    sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};

use super::{chunk::MAX_RECORD_BYTES, scan::Scan};
use crate::{BagError, BagWarning, CDR, Schema, TopicInfo, schema::canonical_type_name};

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
    pub channels: HashMap<u16, TopicInfo>,
    pub segments: Vec<Segment>,
    /// The first and the last log time, in ns.
    pub span: Option<(u64, u64)>,
    /// Compressions of the chunks, as MCAP names them.
    pub compressions: BTreeSet<String>,
}

impl FileIndex {
    /// Indexes a file, by its summary if it has one, else by reading all of it once.
    pub fn read(path: &Path) -> Result<(Self, Vec<BagWarning>), BagError> {
        let io = |source| BagError::io(path, source);
        let mut file = File::open(path).map_err(io)?;
        let size_bytes = file.metadata().map_err(io)?.len();
        check_magic(&mut file, path, size_bytes)?;
        let mut index = Self {
            path: path.to_owned(),
            size_bytes,
            channels: HashMap::new(),
            segments: Vec::new(),
            span: None,
            compressions: BTreeSet::new(),
        };
        let mut warnings = Vec::new();
        let mut scan = Scan::new(file, path, size_bytes);
        match read_summary(&mut scan.file, size_bytes).map_err(io)? {
            Ok(Some(summary)) => {
                index.take_summary(&summary)?;
                scan.outside_chunks(&mut index, &summary)?;
            }
            no_summary => {
                let has_end = has_end_magic(&mut scan.file, size_bytes).map_err(io)?;
                let outcome = scan.everything(&mut index)?;
                warnings.append(&mut scan.warnings);
                if !has_end || !outcome.reached_end {
                    let lost_bytes = size_bytes.saturating_sub(outcome.end);
                    warnings.push(BagWarning::Truncated {
                        file: path.to_owned(),
                        lost_bytes,
                    });
                } else if let Err(reason) = no_summary {
                    warnings.push(BagWarning::NoSummary {
                        file: path.to_owned(),
                        reason,
                    });
                }
            }
        }
        warnings.append(&mut scan.warnings);
        Ok((index, warnings))
    }

    fn take_summary(&mut self, summary: &Summary) -> Result<(), BagError> {
        for channel in summary.channels.values() {
            let schema = channel.schema.as_ref();
            self.add_channel(
                channel.id,
                &channel.topic,
                &channel.message_encoding,
                channel
                    .metadata
                    .get("offered_qos_profiles")
                    .map_or("", String::as_str),
                schema.map(|schema| {
                    (
                        schema.name.as_str(),
                        schema.encoding.as_str(),
                        &*schema.data,
                    )
                }),
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
        schema: Option<(&str, &str, &[u8])>,
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
        let Some((schema_name, schema_encoding, text)) = schema else {
            return Err(BagError::NoType {
                path: self.path.clone(),
                topic: topic.to_owned(),
            });
        };
        let schema = Schema {
            encoding: schema_encoding.into(),
            text: String::from_utf8_lossy(text).into_owned(),
        };
        self.channels.insert(
            id,
            TopicInfo {
                name: topic.into(),
                type_name: canonical_type_name(schema_name)?.into(),
                schema: Arc::new(schema),
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

/// Tells a bag from other files.
fn check_magic(file: &mut File, path: &Path, size_bytes: u64) -> Result<(), BagError> {
    if size_bytes == 0 {
        return Err(BagError::Empty {
            path: path.to_owned(),
            reason: "the file has 0 bytes",
        });
    }
    let mut front = Vec::new();
    file.take(16)
        .read_to_end(&mut front)
        .map_err(|source| BagError::io(path, source))?;
    let not_a_bag = |reason: &str| {
        Err(BagError::NotABag {
            path: path.to_owned(),
            reason: reason.to_owned(),
        })
    };
    if front.starts_with(MAGIC) {
        Ok(())
    } else if front.starts_with(b"SQLite format 3") {
        Err(BagError::Storage {
            path: path.to_owned(),
            storage: "sqlite3".to_owned(),
        })
    } else if front.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        Err(BagError::RosbagCompression {
            path: path.to_owned(),
            mode: "file".to_owned(),
            format: "zstd".to_owned(),
        })
    } else if front.starts_with(b"#ROSBAG") {
        not_a_bag("it is a ROS 1 bag; `rosbags-convert` makes a ROS 2 bag of it")
    } else if MAGIC.starts_with(&front) {
        not_a_bag("it ends within the first bytes of an MCAP file")
    } else {
        not_a_bag("expected an MCAP file or a directory with one")
    }
}

fn has_end_magic(file: &mut BufReader<File>, size_bytes: u64) -> std::io::Result<bool> {
    if size_bytes < 2 * MAGIC.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::Start(size_bytes - MAGIC.len() as u64))?;
    let mut end = Vec::new();
    file.read_to_end(&mut end)?;
    Ok(end == MAGIC)
}

/// The file's summary. None if it has none that says where the messages are; the inner error says why it is wrong.
fn read_summary(
    file: &mut BufReader<File>,
    size_bytes: u64,
) -> std::io::Result<Result<Option<Summary>, String>> {
    let options = SummaryReaderOptions::default()
        .with_file_size(size_bytes)
        // Bounds fit the address space of the 64-bit targets that ROS 2 has.
        .with_record_length_limit(MAX_RECORD_BYTES as usize);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(SummaryReadEvent::ReadRequest(bytes)) => {
                let read = file.read(reader.insert(bytes))?;
                reader.notify_read(read);
            }
            Ok(SummaryReadEvent::SeekRequest(to)) => {
                let position = file.seek(to)?;
                reader.notify_seeked(position);
            }
            Err(error) => return Ok(Err(error.to_string())),
        }
    }
    let Some(summary) = reader.finish() else {
        return Ok(Ok(None));
    };
    let Some(stats) = &summary.stats else {
        return Ok(Ok(None));
    };
    let indexed = summary.chunk_indexes.len() as u64;
    if indexed != u64::from(stats.chunk_count) {
        return Ok(Err(format!(
            "it counts {} chunks and indexes {indexed}",
            stats.chunk_count
        )));
    }
    let in_file = |chunk: &mcap::records::ChunkIndex| {
        chunk.chunk_length <= MAX_RECORD_BYTES
            && chunk
                .chunk_start_offset
                .checked_add(chunk.chunk_length)
                .is_some_and(|end| end <= size_bytes)
    };
    if let Some(chunk) = summary.chunk_indexes.iter().find(|chunk| !in_file(chunk)) {
        return Ok(Err(format!(
            "it puts a chunk at byte {}, which the file cannot hold",
            chunk.chunk_start_offset
        )));
    }
    let described = summary.channels.len() as u64;
    if described != u64::from(stats.channel_count) {
        return Ok(Err(format!(
            "it counts {} channels and describes {described}",
            stats.channel_count
        )));
    }
    let by_channel = stats
        .channel_message_counts
        .values()
        .fold(0, |sum: u64, count| sum.saturating_add(*count));
    if by_channel != stats.message_count {
        return Ok(Err(format!(
            "it counts {} messages, and {by_channel} by channel",
            stats.message_count
        )));
    }
    Ok(Ok(Some(summary)))
}
