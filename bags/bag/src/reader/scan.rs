//! Finding the messages of a file by walking its records.
//!
//! `mcap::sans_io::LinearReader` is not used. It gives no offsets of records, which segments need; it starts at the front of
//! a file, and the gaps between indexed chunks do not; it reads attachments whole; and it ends at the first damaged record.

use std::{
    collections::BTreeSet,
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use bytes::Bytes;
use mcap::{
    MAGIC,
    records::{Record, op},
};

use super::{
    chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompress, record_header},
    definitions::Definitions,
    file_index::{FileIndex, Segment, SegmentPlace},
    record::parse,
};
use crate::{BagError, BagWarning};

/// Size of a segment of messages outside chunks, approximately.
const SEGMENT_BYTES: u64 = 1 << 20;

/// Limit of warnings with details about damaged places, which bounds the memory.
const REPORTS_LIMIT: u64 = 100;

/// The result of a scan.
pub(super) struct ScanEnd {
    /// End of the last whole record.
    pub end: u64,
    /// Whether the record at the end of the data, or the footer, was found.
    pub reached_end: bool,
}

/// A segment to which messages are still added.
struct OpenSegment {
    offset: u64,
    length: u64,
    start_ns: u64,
    end_ns: u64,
    channels: BTreeSet<u16>,
}

impl From<OpenSegment> for Segment {
    fn from(open: OpenSegment) -> Self {
        Self {
            place: SegmentPlace::Bytes {
                offset: open.offset,
                length: open.length,
            },
            start_ns: open.start_ns,
            end_ns: open.end_ns,
            channels: Some(open.channels.into_iter().collect()),
        }
    }
}

/// Indexes the records of a file.
pub(super) struct Scan<'a> {
    pub file: BufReader<File>,
    path: &'a Path,
    size_bytes: u64,
    definitions: Definitions,
    open: Option<OpenSegment>,
    warnings: Vec<BagWarning>,
    damaged_places: u64,
}

impl<'a> Scan<'a> {
    pub fn new(file: File, path: &'a Path, size_bytes: u64) -> Self {
        Self {
            file: BufReader::new(file),
            path,
            size_bytes,
            definitions: Definitions::default(),
            open: None,
            warnings: Vec::new(),
            damaged_places: 0,
        }
    }

    /// Indexes the whole file.
    pub fn scan_all(&mut self, index: &mut FileIndex) -> Result<ScanEnd, BagError> {
        self.scan_range(MAGIC.len() as u64, self.size_bytes, index)
    }

    /// Indexes messages outside the summary's chunks (from byte to byte, in order). Files whose chunks are adjacent, as usual,
    /// cost nothing.
    pub fn scan_gaps(
        &mut self,
        index: &mut FileIndex,
        chunks: impl IntoIterator<Item = (u64, u64)>,
    ) -> Result<(), BagError> {
        let mut from = MAGIC.len() as u64;
        for (start, end) in chunks {
            self.scan_range(from, start, index)?;
            from = end;
        }
        self.scan_range(from, self.size_bytes, index)?;
        Ok(())
    }

    /// Indexes the records between two bytes.
    fn scan_range(
        &mut self,
        from: u64,
        to: u64,
        index: &mut FileIndex,
    ) -> Result<ScanEnd, BagError> {
        let io = |source| BagError::io(self.path, source);
        let mut at = from;
        let mut reached_end = false;
        if from < to {
            self.file.seek(SeekFrom::Start(from)).map_err(io)?;
        }
        while to.saturating_sub(at) >= RECORD_HEADER_BYTES {
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
            let wanted = matches!(opcode, op::MESSAGE | op::CHUNK | op::SCHEMA | op::CHANNEL);
            if !wanted {
                // Attachments, metadata and indexes may be large.
                self.skip(length)?;
            } else if length > MAX_RECORD_BYTES {
                self.skip(length)?;
                self.warn(
                    at,
                    format!(
                        "a record has {length} bytes, more than the limit of {MAX_RECORD_BYTES}"
                    ),
                );
            } else {
                let body = self.read_body(length)?;
                self.index_top_record(opcode, body, (at, end), index);
            }
            at = end;
        }
        index.segments.extend(self.open.take().map(Segment::from));
        Ok(ScanEnd {
            end: at,
            reached_end,
        })
    }

    /// Reads a record's body, whose length is bounded by the file and by [`MAX_RECORD_BYTES`].
    fn read_body(&mut self, length: u64) -> Result<Bytes, BagError> {
        let mut body = vec![0; length as usize];
        let read = self.file.read_exact(&mut body);
        read.map_err(|source| BagError::io(self.path, source))?;
        Ok(body.into())
    }

    fn skip(&mut self, length: u64) -> Result<(), BagError> {
        // Fits: the record ends within the file.
        self.file
            .seek_relative(length as i64)
            .map_err(|source| BagError::io(self.path, source))
    }

    /// Indexes the chunk between two bytes by its messages, because the file's indexes differ.
    pub fn scan_chunk(
        &mut self,
        (at, end): (u64, u64),
        index: &mut FileIndex,
    ) -> Result<(), BagError> {
        let from = SeekFrom::Start(at + RECORD_HEADER_BYTES);
        let found = self.file.seek(from);
        found.map_err(|source| BagError::io(self.path, source))?;
        let body = self.read_body(end - at - RECORD_HEADER_BYTES)?;
        self.index_top_record(op::CHUNK, body, (at, end), index);
        Ok(())
    }

    /// The faults that the scan found.
    pub fn into_warnings(self) -> Vec<BagWarning> {
        let mut warnings = self.warnings;
        if let Some(places) = self.damaged_places.checked_sub(REPORTS_LIMIT)
            && places > 0
        {
            warnings.push(BagWarning::MoreDamaged {
                file: self.path.to_owned(),
                places,
            });
        }
        warnings
    }

    fn warn(&mut self, offset: u64, reason: String) {
        self.damaged_places += 1;
        if self.damaged_places > REPORTS_LIMIT {
            return;
        }
        self.warnings.push(BagWarning::Damaged {
            file: self.path.to_owned(),
            offset,
            reason,
        });
    }

    /// Indexes a top-level record between two bytes.
    fn index_top_record(
        &mut self,
        opcode: u8,
        body: Bytes,
        (at, end): (u64, u64),
        index: &mut FileIndex,
    ) {
        if opcode != op::CHUNK {
            if let Some((channel, log_time_ns)) = self.index_record(opcode, &body, at, index) {
                self.extend_segment(at, end, (channel, log_time_ns), index);
            }
            return;
        }
        index.segments.extend(self.open.take().map(Segment::from));
        let header = match parse(op::CHUNK, &body) {
            Ok(Record::Chunk { header, .. }) => header,
            Ok(_) => return,
            Err(error) => return self.warn(at, error),
        };
        index.compressions.insert(header.compression);
        let mut chunk = OpenSegment {
            offset: at,
            length: end - at,
            start_ns: u64::MAX,
            end_ns: 0,
            channels: BTreeSet::new(),
        };
        match decompress(&body) {
            Ok(records) => {
                for record in Records::new(records) {
                    match record {
                        Ok(record) => {
                            let found = self.index_record(record.opcode, &record.body, at, index);
                            if let Some((channel, log_time_ns)) = found {
                                chunk.channels.insert(channel);
                                chunk.start_ns = chunk.start_ns.min(log_time_ns);
                                chunk.end_ns = chunk.end_ns.max(log_time_ns);
                            }
                        }
                        Err(reason) => self.warn(at, reason),
                    }
                }
            }
            Err(reason) => {
                self.warn(at, reason);
                // Reading reports the damage again at its place.
                let (one, other) = (header.message_start_time, header.message_end_time);
                index.segments.push(Segment {
                    place: SegmentPlace::Bytes {
                        offset: at,
                        length: end - at,
                    },
                    start_ns: one.min(other),
                    end_ns: one.max(other),
                    channels: None,
                });
                return;
            }
        }
        if !chunk.channels.is_empty() {
            index.segments.push(chunk.into());
        }
    }

    /// Adds a schema, channel or message to the index; returns channel and log time of a message.
    fn index_record(
        &mut self,
        opcode: u8,
        body: &[u8],
        at: u64,
        index: &mut FileIndex,
    ) -> Option<(u16, u64)> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return None;
        }
        match parse(opcode, body) {
            Ok(Record::Channel(channel)) => {
                let id = channel.id;
                self.definitions.add(Record::Channel(channel));
                if let Some(channel) = self.definitions.channel(id) {
                    index.add_channel(&channel);
                }
            }
            Ok(Record::Message { header, .. }) => {
                index.count(header.channel_id, header.log_time);
                return Some((header.channel_id, header.log_time));
            }
            Ok(schema) => self.definitions.add(schema),
            Err(error) => self.warn(at, error),
        }
        None
    }

    /// Adds a message outside chunks to the open segment.
    fn extend_segment(
        &mut self,
        at: u64,
        end: u64,
        (channel, log_time_ns): (u16, u64),
        index: &mut FileIndex,
    ) {
        match &mut self.open {
            Some(open) if end - open.offset <= SEGMENT_BYTES => {
                open.length = end - open.offset;
                open.start_ns = open.start_ns.min(log_time_ns);
                open.end_ns = open.end_ns.max(log_time_ns);
                open.channels.insert(channel);
            }
            full => {
                let next = OpenSegment {
                    offset: at,
                    length: end - at,
                    start_ns: log_time_ns,
                    end_ns: log_time_ns,
                    channels: BTreeSet::from([channel]),
                };
                index.segments.extend(full.replace(next).map(Segment::from));
            }
        }
    }
}
