//! Finding the messages of a file by walking its records.

use std::{
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use bytes::Bytes;
use mcap::{
    MAGIC, Summary, parse_record,
    records::{Record, op},
};

use super::{
    chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompressed, record_header},
    definitions::Definitions,
    file_index::{FileIndex, Segment},
};
use crate::{BagError, BagWarning};

/// Messages outside chunks are read in stretches of about this size.
const STRETCH_BYTES: u64 = 1 << 20;

/// Damaged places of a file that are reported one by one; a file of nothing else could fill the memory.
const DAMAGE_TOLD: u64 = 100;

/// How far a scan came.
pub(super) struct ScanEnd {
    /// The end of the last whole record.
    pub end: u64,
    /// Whether the record that ends the data, or the footer, was met.
    pub reached_end: bool,
}

/// Walks the records of a file.
pub(super) struct Scan<'a> {
    pub file: BufReader<File>,
    path: &'a Path,
    size_bytes: u64,
    definitions: Definitions,
    /// The stretch of messages outside chunks that is being gathered.
    stretch: Option<Segment>,
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
        self.range(MAGIC.len() as u64, self.size_bytes, index, true)
    }

    /// Finds the messages that are in no chunk, in the gaps between the chunks that the summary lists. A file whose
    /// chunks touch each other, as most do, costs nothing here.
    pub fn outside_chunks(
        &mut self,
        index: &mut FileIndex,
        summary: &Summary,
    ) -> Result<(), BagError> {
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
                self.warn(
                    at,
                    format!(
                        "a record has {length} bytes, more than the limit of {MAX_RECORD_BYTES}"
                    ),
                );
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

    /// What is wrong with the file, as far as it was met.
    pub fn into_warnings(self) -> Vec<BagWarning> {
        let mut warnings = self.warnings;
        if let Some(places) = self.damaged_places.checked_sub(DAMAGE_TOLD)
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
        if self.damaged_places > DAMAGE_TOLD {
            return;
        }
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
            Ok(Record::Channel(channel)) => {
                let id = channel.id;
                self.definitions.add(Record::Channel(channel));
                if let Some(channel) = self.definitions.channel(id) {
                    index.add_channel(&channel)?;
                }
            }
            Ok(Record::Message { header, .. }) => {
                if fully {
                    index.count(header.channel_id, header.log_time);
                }
                return Ok(Some(header.log_time));
            }
            Ok(schema) => self.definitions.add(schema),
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
