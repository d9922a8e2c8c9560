//! Finds the undamaged parts of a file by scanning all of it.
//!
//! `mcap::sans_io::LinearReader` is not used: it ends at the first damaged record, and the sound chunks after it are wanted.

use std::{
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use mcap::{
    MAGIC,
    records::{Record, op},
};

use super::{
    frame::{CHUNK_PREFIX, is_chunk, is_exact},
    loss::Losses,
};
use crate::{
    BagError, Compression,
    reader::{
        chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompress, record_header},
        definitions::Definitions,
        indexing::{Storage, detect_storage},
        record::parse,
        stored_file::StoredFile,
    },
};

/// An undamaged range of a file.
#[derive(Clone, Copy, Debug)]
pub(super) struct IntactRange {
    /// First byte.
    pub offset: u64,
    /// End (exclusive).
    pub end: u64,
    /// Whether it is a chunk; otherwise messages outside chunks.
    pub is_chunk: bool,
}

/// The undamaged contents of a file.
pub(super) struct Survey {
    pub intact: Vec<IntactRange>,
    pub definitions: Definitions,
    /// Compression of the first chunk.
    pub compression: Option<Compression>,
    /// Whether the file has its end magic.
    pub has_end: bool,
}

/// Reads a file; adds damaged parts to `losses`.
pub(super) fn examine(stored: &StoredFile, losses: &mut Losses) -> Result<Survey, BagError> {
    let path = stored.path.as_path();
    let io = |source| BagError::io(path, source);
    let mut file = stored.file().map_err(io)?;
    file.seek(SeekFrom::Start(0)).map_err(io)?;
    let size_bytes = file.metadata().map_err(io)?.len();
    match detect_storage(&mut file, path, size_bytes) {
        Ok(Storage::Sqlite) => Err(BagError::NotRecoverable {
            path: path.to_owned(),
        }),
        Ok(Storage::Mcap) => Walk::new(file, path, size_bytes, losses).run(MAGIC.len() as u64),
        // Perhaps only the first bytes are damaged.
        Err(error @ BagError::NotABag { .. }) => {
            let before = losses.clone();
            let mut walk = Walk::new(file, path, size_bytes, losses);
            let first = walk.next_chunk(0)?.unwrap_or(size_bytes);
            walk.add_loss(
                0,
                first,
                0,
                "it does not begin like an MCAP file".to_owned(),
            );
            let found = walk.run(first)?;
            if found.intact.is_empty() {
                *losses = before;
                return Err(error);
            }
            Ok(found)
        }
        Err(error) => Err(error),
    }
}

struct Walk<'a> {
    file: BufReader<File>,
    path: &'a Path,
    size_bytes: u64,
    losses: &'a mut Losses,
    found: Survey,
    /// Whether the record at the end of the data was read: only indexes and summary, which are rebuilt, follow it.
    is_after_data: bool,
    /// Whether only indexes were read since the last chunk.
    is_after_chunk: bool,
}

impl<'a> Walk<'a> {
    fn new(file: File, path: &'a Path, size_bytes: u64, losses: &'a mut Losses) -> Self {
        Self {
            file: BufReader::new(file),
            path,
            size_bytes,
            losses,
            found: Survey {
                intact: Vec::new(),
                definitions: Definitions::default(),
                compression: None,
                has_end: false,
            },
            is_after_data: false,
            is_after_chunk: false,
        }
    }

    fn run(mut self, from: u64) -> Result<Survey, BagError> {
        let mut at = from;
        while at < self.size_bytes {
            at = self.step(at)?;
        }
        Ok(self.found)
    }

    /// Reads up to `length` bytes from `at`; fewer at the end of the file.
    fn bytes(&mut self, at: u64, length: u64) -> Result<Vec<u8>, BagError> {
        let io = |source| BagError::io(self.path, source);
        let mut bytes = Vec::new();
        self.file.seek(SeekFrom::Start(at)).map_err(io)?;
        (&mut self.file)
            .take(length)
            .read_to_end(&mut bytes)
            .map_err(io)?;
        Ok(bytes)
    }

    /// Examines the record at `at`; returns the place of the next one.
    fn step(&mut self, at: u64) -> Result<u64, BagError> {
        let front = self.bytes(at, RECORD_HEADER_BYTES + CHUNK_PREFIX as u64)?;
        // Empty at the end of the file; a prefix that is too short matches no record.
        let prefix = front.get(RECORD_HEADER_BYTES as usize..).unwrap_or(&[]);
        let Some((opcode, length)) = record_header(&front) else {
            // Never empty: `at` is within the file.
            let opcode = front.first().copied().unwrap_or(0);
            let is_index = matches!(opcode, op::MESSAGE_INDEX | op::DATA_END);
            let reason = "the file ends within a record's first bytes";
            return self.skip_damage(at, opcode, is_index, reason);
        };
        let end = length
            .checked_add(RECORD_HEADER_BYTES)
            .and_then(|size| size.checked_add(at));
        let Some(end) = end.filter(|end| *end <= self.size_bytes) else {
            let is_index = is_cut_index(opcode, prefix, length);
            let reason = "its length is more than the file holds";
            return self.skip_damage(at, opcode, is_index, reason);
        };
        let within = prefix.get(..length.min(prefix.len() as u64) as usize);
        // In range: limited to the prefix.
        if is_chunk(within.unwrap_or(&[]), length) {
            self.chunk(at, end)?;
            self.is_after_chunk = true;
            return Ok(end);
        }
        if self.is_after_chunk && self.is_index(opcode, at, length)? {
            return Ok(end);
        }
        self.is_after_chunk = false;
        if opcode == op::CHUNK {
            return self.skip_damage(at, opcode, false, "the lengths in it contradict each other");
        }
        if matches!(opcode, op::MESSAGE | op::ATTACHMENT) || opcode > op::DATA_END || opcode == 0 {
            return self.record_without_frame(at, opcode, end);
        }
        if length > MAX_RECORD_BYTES {
            return self.skip_damage(
                at,
                opcode,
                false,
                "it is larger than the limit for a record",
            );
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        if !is_exact(opcode, &body) {
            return self.skip_damage(at, opcode, false, "the lengths in it contradict each other");
        }
        match opcode {
            op::DATA_END => self.is_after_data = true,
            op::FOOTER => {
                let after = self.bytes(end, MAGIC.len() as u64 + 1)?;
                if after == MAGIC {
                    self.found.has_end = true;
                    return Ok(self.size_bytes);
                }
            }
            op::SCHEMA | op::CHANNEL => match parse(opcode, &body) {
                Ok(record) => self.found.definitions.add(record),
                Err(error) => self.add_loss(at, end, 0, error),
            },
            op::METADATA => match parse(opcode, &body) {
                // The recorder's copy of metadata.yaml, which is rebuilt.
                Ok(Record::Metadata(metadata)) if metadata.name == "rosbag2" => {}
                _ => self.add_loss(at, end, 0, "metadata records are not copied".to_owned()),
            },
            _ => {}
        }
        Ok(end)
    }

    /// Whether the record after a chunk is one of its indexes. Otherwise an index whose opcode was damaged into that of a
    /// message would become one, since messages outside chunks have no checksum.
    fn is_index(&mut self, opcode: u8, at: u64, length: u64) -> Result<bool, BagError> {
        if !matches!(opcode, op::MESSAGE | op::MESSAGE_INDEX) || length > MAX_RECORD_BYTES {
            return Ok(false);
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        Ok(is_exact(op::MESSAGE_INDEX, &body))
    }

    /// Adds a chunk if it is undamaged.
    fn chunk(&mut self, at: u64, end: u64) -> Result<(), BagError> {
        let length = end - at - RECORD_HEADER_BYTES;
        if length > MAX_RECORD_BYTES {
            let reason = format!("expected at most {MAX_RECORD_BYTES} bytes, got {length}");
            self.add_loss(at, end, 1, reason);
            return Ok(());
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        if let Err(reason) = self.sound_chunk(&body) {
            self.add_loss(at, end, 1, reason);
            return Ok(());
        }
        self.found.intact.push(IntactRange {
            offset: at,
            end,
            is_chunk: true,
        });
        Ok(())
    }

    /// Adds the definitions of a chunk if all of it can be read.
    fn sound_chunk(&mut self, body: &[u8]) -> Result<(), String> {
        let Record::Chunk { header, .. } = parse(op::CHUNK, body)? else {
            return Err("it is not a chunk".to_owned());
        };
        let mut definitions = Vec::new();
        for record in Records::new(decompress(body)?) {
            let record = record?;
            let is_definition = matches!(record.opcode, op::SCHEMA | op::CHANNEL);
            if (is_definition || record.opcode == op::MESSAGE)
                && !is_exact(record.opcode, &record.body)
            {
                return Err(
                    "the length of a record in it differs from that of its fields".to_owned(),
                );
            }
            if is_definition {
                definitions.push(record);
            }
        }
        let definitions = definitions
            .iter()
            .map(|record| parse(record.opcode, &record.body))
            .collect::<Result<Vec<_>, _>>()?;
        for definition in definitions {
            self.found.definitions.add(definition);
        }
        let compression = Compression::of_mcap(&header.compression);
        self.found.compression = self.found.compression.or(compression);
        Ok(())
    }

    /// Examines a record that has no inner lengths: the record after it confirms its length.
    fn record_without_frame(&mut self, at: u64, opcode: u8, end: u64) -> Result<u64, BagError> {
        let length = end - at - RECORD_HEADER_BYTES;
        let after = self.bytes(end, RECORD_HEADER_BYTES)?;
        let is_known = |opcode: u8| (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        // The last record of a truncated file has at most a part of a record after it.
        let is_followed = match record_header(&after) {
            Some((next, length)) => is_known(next) && length <= MAX_RECORD_BYTES,
            None => after.first().is_none_or(|next| is_known(*next)),
        };
        if !is_followed && after.get(..MAGIC.len()) != Some(MAGIC) {
            return self.skip_damage(at, opcode, false, "no record follows it");
        }
        match opcode {
            // Probably a damaged record of the summary, where no message can be.
            op::MESSAGE if self.is_after_data => {}
            op::MESSAGE if !(super::frame::MESSAGE_PREFIX..=MAX_RECORD_BYTES).contains(&length) => {
                self.add_loss(at, end, 0, format!("a message of {length} bytes"));
            }
            op::MESSAGE => match self.found.intact.last_mut() {
                Some(last) if !last.is_chunk && last.end == at => last.end = end,
                _ => self.found.intact.push(IntactRange {
                    offset: at,
                    end,
                    is_chunk: false,
                }),
            },
            op::ATTACHMENT => self.add_loss(at, end, 0, "attachments are not copied".to_owned()),
            // Private records are ignored; undefined opcodes are damage.
            0x80.. => {}
            _ => self.add_loss(at, end, 0, format!("unknown opcode {opcode:#04x}")),
        }
        Ok(end)
    }

    /// Counts the bytes between the damaged record at `at` and the next recognised place as lost; returns that place. Indexes
    /// and summary are rebuilt: a file that ends within them has lost nothing.
    fn skip_damage(
        &mut self,
        at: u64,
        opcode: u8,
        is_index: bool,
        reason: &str,
    ) -> Result<u64, BagError> {
        let next = self.next_chunk(at + 1)?;
        if next.is_some() || !(is_index || self.is_after_data) {
            let end = next.unwrap_or(self.size_bytes);
            let chunks = u64::from(opcode == op::CHUNK);
            self.add_loss(at, end, chunks, reason.to_owned());
        }
        Ok(next.unwrap_or(self.size_bytes))
    }

    fn add_loss(&mut self, at: u64, end: u64, chunks: u64, reason: String) {
        self.losses.add(self.path, at, end - at, chunks, &reason);
    }

    /// The start of the next chunk, or the end of the messages.
    fn next_chunk(&mut self, from: u64) -> Result<Option<u64>, BagError> {
        /// Number of bytes searched at once.
        const WINDOW: u64 = 1 << 20;
        const FRONT: usize = RECORD_HEADER_BYTES as usize + CHUNK_PREFIX;
        const DATA_END: [u8; 9] = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
        let mut at = from;
        while at < self.size_bytes {
            // The windows overlap, so that no pattern is split.
            let window = self.bytes(at, WINDOW + FRONT as u64)?;
            let searched = window.len().min(WINDOW as usize);
            for (offset, opcode) in window.iter().take(searched).enumerate() {
                if !matches!(*opcode, op::CHUNK | op::DATA_END) {
                    continue;
                }
                // In range: `offset` is below the window's size.
                let front = window.get(offset..).unwrap_or(&[]);
                let Some((header, body)) = front.split_at_checked(RECORD_HEADER_BYTES as usize)
                else {
                    continue;
                };
                let place = at + offset as u64;
                let length = record_header(header).map_or(u64::MAX, |(_, length)| length);
                let room = (self.size_bytes - place).saturating_sub(RECORD_HEADER_BYTES);
                // In range: limited to the body.
                let prefix = body.get(..body.len().min(CHUNK_PREFIX)).unwrap_or(&[]);
                let is_chunk = *opcode == op::CHUNK && length <= room && is_chunk(prefix, length);
                if is_chunk || header == DATA_END {
                    return Ok(Some(place));
                }
            }
            at += searched as u64;
        }
        Ok(None)
    }
}

/// Whether a truncated record is an index after a chunk, or the end of the data, by opcode and length.
fn is_cut_index(opcode: u8, prefix: &[u8], length: u64) -> bool {
    let entries = prefix
        .get(2..)
        .and_then(|rest| rest.first_chunk::<4>())
        .map(|entries| u64::from(u32::from_le_bytes(*entries)));
    match opcode {
        op::MESSAGE_INDEX => entries.is_none_or(|entries| entries + 6 == length),
        op::DATA_END => length == 4,
        _ => false,
    }
}
