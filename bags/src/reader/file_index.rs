use std::{
    collections::{BTreeSet, HashMap},
    fs::File,
    io::{BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
};

use bytes::Bytes;
use mcap::{
    MAGIC, Summary, parse_record,
    records::{Record, op},
    sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};

use super::chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompressed, record_header};
use crate::{BagError, BagWarning, CDR, Schema, TopicInfo, schema::canonical_type_name};

/// Messages outside chunks are read in stretches of about this size.
const STRETCH_BYTES: u64 = 1 << 20;

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

    fn add_channel(
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

    fn count(&mut self, channel_id: u16, log_time_ns: u64) {
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

/// How far a scan came.
struct ScanEnd {
    /// The end of the last whole record.
    end: u64,
    /// Whether the record that ends the data, or the footer, was met.
    reached_end: bool,
}

/// Walks the records of a file.
struct Scan<'a> {
    file: BufReader<File>,
    path: &'a Path,
    size_bytes: u64,
    schemas: HashMap<u16, (String, String, Vec<u8>)>,
    /// The stretch of messages outside chunks that is being gathered.
    stretch: Option<Segment>,
    warnings: Vec<BagWarning>,
}

impl<'a> Scan<'a> {
    fn new(file: File, path: &'a Path, size_bytes: u64) -> Self {
        Self {
            file: BufReader::new(file),
            path,
            size_bytes,
            schemas: HashMap::new(),
            stretch: None,
            warnings: Vec::new(),
        }
    }

    /// Reads the whole file: channels, counts, segments.
    fn everything(&mut self, index: &mut FileIndex) -> Result<ScanEnd, BagError> {
        self.range(MAGIC.len() as u64, self.size_bytes, index, true)
    }

    /// Finds the messages that are in no chunk, in the gaps between the chunks that the summary lists. A file whose
    /// chunks touch each other, as most do, costs nothing here.
    fn outside_chunks(&mut self, index: &mut FileIndex, summary: &Summary) -> Result<(), BagError> {
        let mut chunks: Vec<(u64, u64)> = summary
            .chunk_indexes
            .iter()
            .map(|chunk| {
                let end = chunk.chunk_start_offset.saturating_add(chunk.chunk_length);
                (
                    chunk.chunk_start_offset,
                    end.saturating_add(chunk.message_index_length),
                )
            })
            .collect();
        chunks.sort_unstable();
        let mut from = MAGIC.len() as u64;
        for (start, end) in chunks {
            self.range(from, start, index, false)?;
            from = end;
        }
        self.range(from, self.size_bytes, index, false)?;
        Ok(())
    }

    /// Walks the records from one byte to another. `fully`: the file has no summary, so that chunks, channels and
    /// counts are taken from here.
    fn range(
        &mut self,
        from: u64,
        to: u64,
        index: &mut FileIndex,
        fully: bool,
    ) -> Result<ScanEnd, BagError> {
        let io = |source| BagError::io(self.path, source);
        let mut at = from;
        let mut reached_end = false;
        if from < to {
            self.file.seek(SeekFrom::Start(from)).map_err(io)?;
        }
        while at + RECORD_HEADER_BYTES <= to {
            let mut header = [0; RECORD_HEADER_BYTES as usize];
            self.file
                .read_exact(&mut header)
                .map_err(|source| BagError::io(self.path, source))?;
            let Some((opcode, length)) = record_header(&header) else {
                break;
            };
            let Some(end) = at
                .checked_add(RECORD_HEADER_BYTES)
                .and_then(|body| body.checked_add(length))
            else {
                break;
            };
            if end > to {
                break;
            }
            if matches!(opcode, op::DATA_END | op::FOOTER) {
                reached_end = true;
                at = end;
                break;
            }
            let wanted = match opcode {
                op::MESSAGE => true,
                op::CHUNK | op::SCHEMA | op::CHANNEL => fully,
                _ => false,
            };
            if !wanted {
                // Attachments, metadata and indexes may be large; they are stepped over.
                self.skip(length)?;
            } else if length > MAX_RECORD_BYTES {
                self.skip(length)?;
                self.warn(at, format!("a record of {length} bytes is more than the {MAX_RECORD_BYTES} that are read"));
            } else {
                let mut body = vec![0; length as usize];
                self.file
                    .read_exact(&mut body)
                    .map_err(|source| BagError::io(self.path, source))?;
                self.top_record(opcode, body.into(), at, end, index, fully)?;
            }
            at = end;
        }
        index.segments.extend(self.stretch.take());
        Ok(ScanEnd {
            end: at,
            reached_end,
        })
    }

    fn skip(&mut self, length: u64) -> Result<(), BagError> {
        // The record ends within the file, so that its length fits.
        self.file
            .seek_relative(length as i64)
            .map_err(|source| BagError::io(self.path, source))
    }

    fn warn(&mut self, offset: u64, reason: String) {
        self.warnings.push(BagWarning::Damaged {
            file: self.path.to_owned(),
            offset,
            reason,
        });
    }

    /// A record at the top level of the file, from byte `at` to `end`.
    fn top_record(
        &mut self,
        opcode: u8,
        body: Bytes,
        at: u64,
        end: u64,
        index: &mut FileIndex,
        fully: bool,
    ) -> Result<(), BagError> {
        if opcode != op::CHUNK {
            let log_time_ns = self.record(opcode, &body, at, index, fully)?;
            if let Some(log_time_ns) = log_time_ns {
                self.extend_stretch(at, end, log_time_ns, index);
            }
            return Ok(());
        }
        index.segments.extend(self.stretch.take());
        let header = match parse_record(op::CHUNK, &body) {
            Ok(Record::Chunk { header, .. }) => header,
            Ok(_) => return Ok(()),
            Err(error) => {
                self.warn(at, error.to_string());
                return Ok(());
            }
        };
        index.compressions.insert(header.compression);
        index.segments.push(Segment {
            offset: at,
            length: end - at,
            start_ns: header.message_start_time,
            end_ns: header.message_end_time,
        });
        match decompressed(&body) {
            Ok(records) => {
                for record in Records::new(records) {
                    match record {
                        Ok(record) => {
                            self.record(record.opcode, &record.body, at, index, true)?;
                        }
                        Err(reason) => self.warn(at, reason),
                    }
                }
            }
            Err(reason) => self.warn(at, reason),
        }
        Ok(())
    }

    /// A schema, channel or message; gives the log time of a message. `fully`: channels and counts are taken.
    fn record(
        &mut self,
        opcode: u8,
        body: &[u8],
        at: u64,
        index: &mut FileIndex,
        fully: bool,
    ) -> Result<Option<u64>, BagError> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(None);
        }
        match parse_record(opcode, body) {
            Ok(Record::Schema { header, data }) => {
                self.schemas
                    .insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Ok(Record::Channel(channel)) => {
                let schema = self.schemas.get(&channel.schema_id);
                index.add_channel(
                    channel.id,
                    &channel.topic,
                    &channel.message_encoding,
                    channel
                        .metadata
                        .get("offered_qos_profiles")
                        .map_or("", String::as_str),
                    schema.map(|(name, encoding, text)| {
                        (name.as_str(), encoding.as_str(), text.as_slice())
                    }),
                )?;
            }
            Ok(Record::Message { header, .. }) => {
                if fully {
                    index.count(header.channel_id, header.log_time);
                }
                return Ok(Some(header.log_time));
            }
            Ok(_) => {}
            Err(error) => self.warn(at, error.to_string()),
        }
        Ok(None)
    }

    /// Adds a message outside chunks to the stretch that is being gathered.
    fn extend_stretch(&mut self, at: u64, end: u64, log_time_ns: u64, index: &mut FileIndex) {
        match &mut self.stretch {
            Some(stretch) if end - stretch.offset <= STRETCH_BYTES => {
                stretch.length = end - stretch.offset;
                stretch.start_ns = stretch.start_ns.min(log_time_ns);
                stretch.end_ns = stretch.end_ns.max(log_time_ns);
            }
            full => {
                let next = Segment {
                    offset: at,
                    length: end - at,
                    start_ns: log_time_ns,
                    end_ns: log_time_ns,
                };
                index.segments.extend(full.replace(next));
            }
        }
    }
}
