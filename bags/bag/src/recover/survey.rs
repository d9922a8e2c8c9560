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
        chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, decompressed, record_header},
        definitions::Definitions,
        indexing::{Storage, check_magic},
        record::parse,
        stored_file::StoredFile,
    },
};

/// A stretch of a file whose messages are sound.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    /// Its first byte.
    pub offset: u64,
    /// The byte behind it.
    pub end: u64,
    /// One chunk, or messages that are in none.
    pub is_chunk: bool,
}

/// What a walk over a file has found.
pub(super) struct Survey {
    pub stretches: Vec<Stretch>,
    pub definitions: Definitions,
    /// That of the first chunk.
    pub compression: Option<Compression>,
    /// Whether the file ends as it should.
    pub has_end: bool,
}

/// Walks a file. What is lost is added to `losses`.
pub(super) fn survey(stored: &StoredFile, losses: &mut Losses) -> Result<Survey, BagError> {
    let path = stored.path.as_path();
    let io = |source| BagError::io(path, source);
    let mut file = stored.file().map_err(io)?;
    file.seek(SeekFrom::Start(0)).map_err(io)?;
    let size_bytes = file.metadata().map_err(io)?.len();
    match check_magic(&mut file, path, size_bytes) {
        Ok(Storage::Sqlite) => Err(BagError::NotRecoverable {
            path: path.to_owned(),
        }),
        Ok(Storage::Mcap) => Walk::new(file, path, size_bytes, losses).run(MAGIC.len() as u64),
        // The first bytes may be all that is wrong with it.
        Err(error @ BagError::NotABag { .. }) => {
            let before = losses.clone();
            let mut walk = Walk::new(file, path, size_bytes, losses);
            let first = walk.next_chunk(0)?.unwrap_or(size_bytes);
            walk.lost(
                0,
                first,
                0,
                "it does not begin like an MCAP file".to_owned(),
            );
            let found = walk.run(first)?;
            if found.stretches.is_empty() {
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
    /// Whether the record that ends the messages was met: behind it is only what can be made again.
    is_behind_data: bool,
    /// Whether nothing but indexes lies between the last chunk and here.
    is_behind_chunk: bool,
}

impl<'a> Walk<'a> {
    fn new(file: File, path: &'a Path, size_bytes: u64, losses: &'a mut Losses) -> Self {
        Self {
            file: BufReader::new(file),
            path,
            size_bytes,
            losses,
            found: Survey {
                stretches: Vec::new(),
                definitions: Definitions::default(),
                compression: None,
                has_end: false,
            },
            is_behind_data: false,
            is_behind_chunk: false,
        }
    }

    fn run(mut self, from: u64) -> Result<Survey, BagError> {
        let mut at = from;
        while at < self.size_bytes {
            at = self.step(at)?;
        }
        Ok(self.found)
    }

    /// Up to `length` bytes from `at` on; fewer where the file ends.
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

    /// Takes the record at `at`; gives where the next one is.
    fn step(&mut self, at: u64) -> Result<u64, BagError> {
        let front = self.bytes(at, RECORD_HEADER_BYTES + CHUNK_PREFIX as u64)?;
        let prefix = front.get(RECORD_HEADER_BYTES as usize..).unwrap_or(&[]);
        let Some((opcode, length)) = record_header(&front) else {
            let opcode = front.first().copied().unwrap_or(0);
            let is_index = matches!(opcode, op::MESSAGE_INDEX | op::DATA_END);
            let reason = "the file ends within a record's first bytes";
            return self.damaged(at, opcode, is_index, reason);
        };
        let end = length
            .checked_add(RECORD_HEADER_BYTES)
            .and_then(|size| size.checked_add(at));
        let Some(end) = end.filter(|end| *end <= self.size_bytes) else {
            let is_index = is_cut_index(opcode, prefix, length);
            let reason = "its length is more than the file holds";
            return self.damaged(at, opcode, is_index, reason);
        };
        let within = prefix.get(..length.min(prefix.len() as u64) as usize);
        if is_chunk(within.unwrap_or(&[]), length) {
            self.chunk(at, end)?;
            self.is_behind_chunk = true;
            return Ok(end);
        }
        if self.is_behind_chunk && self.is_index(opcode, at, length)? {
            return Ok(end);
        }
        self.is_behind_chunk = false;
        if opcode == op::CHUNK {
            return self.damaged(at, opcode, false, "the lengths in it contradict each other");
        }
        if matches!(opcode, op::MESSAGE | op::ATTACHMENT) || opcode > op::DATA_END || opcode == 0 {
            return self.unframed(at, opcode, end);
        }
        if length > MAX_RECORD_BYTES {
            return self.damaged(
                at,
                opcode,
                false,
                "it is larger than the limit for a record",
            );
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        if !is_exact(opcode, &body) {
            return self.damaged(at, opcode, false, "the lengths in it contradict each other");
        }
        match opcode {
            op::DATA_END => self.is_behind_data = true,
            op::FOOTER => {
                let behind = self.bytes(end, MAGIC.len() as u64 + 1)?;
                if behind == MAGIC {
                    self.found.has_end = true;
                    return Ok(self.size_bytes);
                }
            }
            op::SCHEMA | op::CHANNEL => match parse(opcode, &body) {
                Ok(record) => self.found.definitions.add(record),
                Err(error) => self.lost(at, end, 0, error),
            },
            op::METADATA => match parse(opcode, &body) {
                // The recorder's own copy of metadata.yaml, which is written anew.
                Ok(Record::Metadata(metadata)) if metadata.name == "rosbag2" => {}
                _ => self.lost(at, end, 0, "metadata records are not copied".to_owned()),
            },
            _ => {}
        }
        Ok(end)
    }

    /// Whether the record behind a chunk is one of its indexes. One whose first byte became that of a message by damage
    /// would be taken for a message otherwise, since messages outside of chunks have no checksum.
    fn is_index(&mut self, opcode: u8, at: u64, length: u64) -> Result<bool, BagError> {
        if !matches!(opcode, op::MESSAGE | op::MESSAGE_INDEX) || length > MAX_RECORD_BYTES {
            return Ok(false);
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        Ok(is_exact(op::MESSAGE_INDEX, &body))
    }

    /// Takes a chunk, if it is sound.
    fn chunk(&mut self, at: u64, end: u64) -> Result<(), BagError> {
        let length = end - at - RECORD_HEADER_BYTES;
        if length > MAX_RECORD_BYTES {
            let reason = format!("expected at most {MAX_RECORD_BYTES} bytes, got {length}");
            self.lost(at, end, 1, reason);
            return Ok(());
        }
        let body = self.bytes(at + RECORD_HEADER_BYTES, length)?;
        if let Err(reason) = self.sound_chunk(&body) {
            self.lost(at, end, 1, reason);
            return Ok(());
        }
        self.found.stretches.push(Stretch {
            offset: at,
            end,
            is_chunk: true,
        });
        Ok(())
    }

    /// Takes the definitions in a chunk all of which can be read.
    fn sound_chunk(&mut self, body: &[u8]) -> Result<(), String> {
        let Record::Chunk { header, .. } = parse(op::CHUNK, body)? else {
            return Err("it is not a chunk".to_owned());
        };
        let mut definitions = Vec::new();
        for record in Records::new(decompressed(body)?) {
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

    /// Takes a record that only its length bounds: what is behind it says whether the length is right.
    fn unframed(&mut self, at: u64, opcode: u8, end: u64) -> Result<u64, BagError> {
        let length = end - at - RECORD_HEADER_BYTES;
        let behind = self.bytes(end, RECORD_HEADER_BYTES)?;
        let is_known = |opcode: u8| (op::HEADER..=op::DATA_END).contains(&opcode) || opcode >= 0x80;
        // The last record of a file that was cut off has nothing behind it, or a part.
        let is_followed = match record_header(&behind) {
            Some((next, length)) => is_known(next) && length <= MAX_RECORD_BYTES,
            None => behind.first().is_none_or(|next| is_known(*next)),
        };
        if !is_followed && behind.get(..MAGIC.len()) != Some(MAGIC) {
            return self.damaged(at, opcode, false, "no record follows it");
        }
        match opcode {
            // A damaged record of the summary, where no message can be.
            op::MESSAGE if self.is_behind_data => {}
            op::MESSAGE if !(super::frame::MESSAGE_PREFIX..=MAX_RECORD_BYTES).contains(&length) => {
                self.lost(at, end, 0, format!("a message of {length} bytes"));
            }
            op::MESSAGE => match self.found.stretches.last_mut() {
                Some(last) if !last.is_chunk && last.end == at => last.end = end,
                _ => self.found.stretches.push(Stretch {
                    offset: at,
                    end,
                    is_chunk: false,
                }),
            },
            op::ATTACHMENT => self.lost(at, end, 0, "attachments are not copied".to_owned()),
            // Private records are nobody's business; those that MCAP has not defined are damage.
            0x80.. => {}
            _ => self.lost(at, end, 0, format!("unknown opcode {opcode:#04x}")),
        }
        Ok(end)
    }

    /// Counts what is between the damaged record at `at` and the next place that is known; gives that place. Indexes
    /// and summary are made anew: a file that was cut off within them has lost nothing.
    fn damaged(
        &mut self,
        at: u64,
        opcode: u8,
        is_index: bool,
        reason: &str,
    ) -> Result<u64, BagError> {
        let next = self.next_chunk(at + 1)?;
        if next.is_some() || !(is_index || self.is_behind_data) {
            let end = next.unwrap_or(self.size_bytes);
            let chunks = u64::from(opcode == op::CHUNK);
            self.lost(at, end, chunks, reason.to_owned());
        }
        Ok(next.unwrap_or(self.size_bytes))
    }

    fn lost(&mut self, at: u64, end: u64, chunks: u64, reason: String) {
        self.losses.add(self.path, at, end - at, chunks, &reason);
    }

    /// Where the next chunk begins, or the end of the messages.
    fn next_chunk(&mut self, from: u64) -> Result<Option<u64>, BagError> {
        /// Bytes that are searched at once.
        const WINDOW: u64 = 1 << 20;
        const FRONT: usize = RECORD_HEADER_BYTES as usize + CHUNK_PREFIX;
        const DATA_END: [u8; 9] = [op::DATA_END, 4, 0, 0, 0, 0, 0, 0, 0];
        let mut at = from;
        while at < self.size_bytes {
            // The windows overlap, so that none cuts what is searched for.
            let window = self.bytes(at, WINDOW + FRONT as u64)?;
            let searched = window.len().min(WINDOW as usize);
            for (offset, opcode) in window.iter().take(searched).enumerate() {
                if !matches!(*opcode, op::CHUNK | op::DATA_END) {
                    continue;
                }
                let front = window.get(offset..).unwrap_or(&[]);
                let Some((header, body)) = front.split_at_checked(RECORD_HEADER_BYTES as usize)
                else {
                    continue;
                };
                let place = at + offset as u64;
                let length = record_header(header).map_or(u64::MAX, |(_, length)| length);
                let room = (self.size_bytes - place).saturating_sub(RECORD_HEADER_BYTES);
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

/// Whether a record that the file has not all of is the index behind a chunk, or the mark behind the messages, by the
/// length in it too.
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
