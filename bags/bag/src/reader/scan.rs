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
    chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompressed, record_header},
    definitions::Definitions,
    file_index::{FileIndex, Segment, SegmentPlace},
    record::parse,
};
use crate::{BagError, BagWarning};

/// Messages outside chunks are read in stretches of about this size.
const STRETCH_BYTES: u64 = 1 << 20;

/// Damaged places of a file that are reported one by one; a file of nothing else could fill the memory.
const MOST_REPORTED: u64 = 100;

/// The end of a scan.
pub(super) struct ScanEnd {
    /// The end of the last whole record.
    pub end: u64,
    /// Whether the record that ends the data, or the footer, was met.
    pub reached_end: bool,
}

/// Messages outside chunks that are being gathered.
struct Stretch {
    offset: u64,
    length: u64,
    start_ns: u64,
    end_ns: u64,
    channels: BTreeSet<u16>,
}

impl From<Stretch> for Segment {
    fn from(stretch: Stretch) -> Self {
        Self {
            place: SegmentPlace::Bytes {
                offset: stretch.offset,
                length: stretch.length,
            },
            start_ns: stretch.start_ns,
            end_ns: stretch.end_ns,
            channels: Some(stretch.channels.into_iter().collect()),
        }
    }
}

/// Walks the records of a file.
pub(super) struct Scan<'a> {
    pub file: BufReader<File>,
    path: &'a Path,
    size_bytes: u64,
    definitions: Definitions,
    stretch: Option<Stretch>,
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
            stretch: None,
            warnings: Vec::new(),
            damaged_places: 0,
        }
    }

    /// Reads the whole file: channels, counts, segments.
    pub fn everything(&mut self, index: &mut FileIndex) -> Result<ScanEnd, BagError> {
        self.range(MAGIC.len() as u64, self.size_bytes, index)
    }

    /// Finds the messages in no chunk that the summary lists, in the gaps between those: from byte to byte, in order. A file
    /// whose chunks touch each other, as most do, costs nothing here.
    pub fn outside(
        &mut self,
        index: &mut FileIndex,
        chunks: impl IntoIterator<Item = (u64, u64)>,
    ) -> Result<(), BagError> {
        let mut from = MAGIC.len() as u64;
        for (start, end) in chunks {
            self.range(from, start, index)?;
            from = end;
        }
        self.range(from, self.size_bytes, index)?;
        Ok(())
    }

    /// Walks the records from one byte to another.
    fn range(&mut self, from: u64, to: u64, index: &mut FileIndex) -> Result<ScanEnd, BagError> {
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
                // Attachments, metadata and indexes may be large; they are stepped over.
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
                let body = self.body(length)?;
                self.top_record(opcode, body, (at, end), index);
            }
            at = end;
        }
        index
            .segments
            .extend(self.stretch.take().map(Segment::from));
        Ok(ScanEnd {
            end: at,
            reached_end,
        })
    }

    /// The next bytes, of a record whose length was held to the file and to [`MAX_RECORD_BYTES`].
    fn body(&mut self, length: u64) -> Result<Bytes, BagError> {
        let mut body = vec![0; length as usize];
        let read = self.file.read_exact(&mut body);
        read.map_err(|source| BagError::io(self.path, source))?;
        Ok(body.into())
    }

    fn skip(&mut self, length: u64) -> Result<(), BagError> {
        // The record ends within the file, so that its length fits.
        self.file
            .seek_relative(length as i64)
            .map_err(|source| BagError::io(self.path, source))
    }

    /// Reads the chunk from one byte to another, on which the file's indexes disagree.
    pub fn chunk_at(
        &mut self,
        (at, end): (u64, u64),
        index: &mut FileIndex,
    ) -> Result<(), BagError> {
        let from = SeekFrom::Start(at + RECORD_HEADER_BYTES);
        let found = self.file.seek(from);
        found.map_err(|source| BagError::io(self.path, source))?;
        let body = self.body(end - at - RECORD_HEADER_BYTES)?;
        self.top_record(op::CHUNK, body, (at, end), index);
        Ok(())
    }

    /// The faults of the file that the scan found.
    pub fn into_warnings(self) -> Vec<BagWarning> {
        let mut warnings = self.warnings;
        if let Some(places) = self.damaged_places.checked_sub(MOST_REPORTED)
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
        if self.damaged_places > MOST_REPORTED {
            return;
        }
        self.warnings.push(BagWarning::Damaged {
            file: self.path.to_owned(),
            offset,
            reason,
        });
    }

    /// A record at the top level of the file, from one byte to another.
    fn top_record(
        &mut self,
        opcode: u8,
        body: Bytes,
        (at, end): (u64, u64),
        index: &mut FileIndex,
    ) {
        if opcode != op::CHUNK {
            if let Some((channel, log_time_ns)) = self.record(opcode, &body, at, index) {
                self.extend_stretch(at, end, (channel, log_time_ns), index);
            }
            return;
        }
        index
            .segments
            .extend(self.stretch.take().map(Segment::from));
        let header = match parse(op::CHUNK, &body) {
            Ok(Record::Chunk { header, .. }) => header,
            Ok(_) => return,
            Err(error) => return self.warn(at, error),
        };
        index.compressions.insert(header.compression);
        let mut chunk = Stretch {
            offset: at,
            length: end - at,
            start_ns: u64::MAX,
            end_ns: 0,
            channels: BTreeSet::new(),
        };
        match decompressed(&body) {
            Ok(records) => {
                for record in Records::new(records) {
                    match record {
                        Ok(record) => {
                            let found = self.record(record.opcode, &record.body, at, index);
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
                // It is named again where it would be read.
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
        // One without a readable message has nothing to be read.
        if !chunk.channels.is_empty() {
            index.segments.push(chunk.into());
        }
    }

    /// A schema, channel or message; gives channel and log time of a message.
    fn record(
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

    /// Adds a message outside chunks to the stretch that is being gathered.
    fn extend_stretch(
        &mut self,
        at: u64,
        end: u64,
        (channel, log_time_ns): (u16, u64),
        index: &mut FileIndex,
    ) {
        match &mut self.stretch {
            Some(stretch) if end - stretch.offset <= STRETCH_BYTES => {
                stretch.length = end - stretch.offset;
                stretch.start_ns = stretch.start_ns.min(log_time_ns);
                stretch.end_ns = stretch.end_ns.max(log_time_ns);
                stretch.channels.insert(channel);
            }
            full => {
                let next = Stretch {
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
