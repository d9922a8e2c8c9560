//! Consistency of the indexes of a file's chunks.
//!
//! Three places name the times of a chunk: its header, the summary's chunk index, and the message indexes after it. If they
//! agree, the chunk itself is not read.

use std::{
    collections::BTreeSet,
    io::{Read, Seek, SeekFrom},
};

use mcap::records::{ChunkIndex, Record, op};

use super::{
    chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, Records, record_header},
    file_index::{FileIndex, Segment, SegmentPlace},
    record::parse,
};

/// Size of opcode, length and the two times at the front of a chunk.
const FRONT_BYTES: usize = RECORD_HEADER_BYTES as usize + 16;

/// A chunk in the summary, compared with its header.
pub(super) struct IndexedChunk {
    /// First byte of the chunk, and its end.
    pub chunk: (u64, u64),
    /// First byte of the chunk, and the end of its message indexes.
    pub place: (u64, u64),
    pub compression: String,
    start_ns: u64,
    end_ns: u64,
    /// Whether header and summary have the same times.
    is_consistent: bool,
}

/// Reads the headers of these chunks, which lie within the file and do not overlap.
///
/// # Errors
/// The outer: the file cannot be read. The inner: the summary lists a chunk that the file does not have.
pub(super) fn read(
    file: &mut (impl Read + Seek),
    chunks: &[ChunkIndex],
) -> std::io::Result<Result<Vec<IndexedChunk>, String>> {
    let mut all = Vec::with_capacity(chunks.len());
    let mut chunks: Vec<&ChunkIndex> = chunks.iter().collect();
    chunks.sort_unstable_by_key(|chunk| chunk.chunk_start_offset);
    for chunk in chunks {
        let (at, length) = (chunk.chunk_start_offset, chunk.chunk_length);
        let mut front = [0; FRONT_BYTES];
        file.seek(SeekFrom::Start(at))?;
        let is_whole = length >= FRONT_BYTES as u64 && read_whole(file, &mut front)?;
        let body = length.wrapping_sub(RECORD_HEADER_BYTES);
        if !is_whole || record_header(&front) != Some((op::CHUNK, body)) {
            return Ok(Err(format!("it puts a chunk at byte {at}, which has none")));
        }
        let time = |from: usize| {
            let bytes = front.get(from..).and_then(|bytes| bytes.first_chunk::<8>());
            bytes.map(|bytes| u64::from_le_bytes(*bytes))
        };
        let times = (Some(chunk.message_start_time), Some(chunk.message_end_time));
        let end = at + length;
        all.push(IndexedChunk {
            chunk: (at, end),
            place: (at, end + chunk.message_index_length),
            compression: chunk.compression.clone(),
            start_ns: chunk.message_start_time,
            end_ns: chunk.message_end_time,
            is_consistent: (time(FRONT_BYTES - 16), time(FRONT_BYTES - 8)) == times,
        });
    }
    Ok(Ok(all))
}

/// Fills the buffer; false if the file ends earlier.
fn read_whole(file: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<bool> {
    match file.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// The messages in the index at byte `at`, in the order of the chunk: offset in the chunk, channel, log time \[ns\].
/// `None` if the index is missing or damaged.
fn message_index(
    file: &mut (impl Read + Seek),
    at: u64,
    length: u64,
) -> std::io::Result<Option<Vec<(u64, u16, u64)>>> {
    if length == 0 || length > MAX_RECORD_BYTES {
        return Ok(None);
    }
    // Fits: bounded by MAX_RECORD_BYTES.
    let mut bytes = vec![0; length as usize];
    file.seek(SeekFrom::Start(at))?;
    if !read_whole(file, &mut bytes)? {
        return Ok(None);
    }
    let mut messages = Vec::new();
    for record in Records::new(bytes.into()) {
        let Ok(record) = record else {
            return Ok(None);
        };
        match parse(record.opcode, &record.body) {
            Ok(Record::MessageIndex(index)) => {
                let entries = index.records.iter();
                messages
                    .extend(entries.map(|entry| (entry.offset, index.channel_id, entry.log_time)));
            }
            _ => return Ok(None),
        }
    }
    messages.sort_unstable();
    Ok(Some(messages))
}

impl IndexedChunk {
    /// Adds the chunk to the index; false, and no change, if the indexes differ.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn take(
        &self,
        file: &mut (impl Read + Seek),
        index: &mut FileIndex,
    ) -> std::io::Result<bool> {
        if !self.is_consistent {
            return Ok(false);
        }
        let (at, end) = (self.chunk.1, self.place.1);
        let Some(messages) = message_index(file, at, end - at)? else {
            return Ok(false);
        };
        let times = messages.iter().map(|(_, _, log_time_ns)| *log_time_ns);
        let found = (times.clone().min(), times.max());
        if found != (Some(self.start_ns), Some(self.end_ns)) {
            return Ok(false);
        }
        let mut channels = BTreeSet::new();
        for (_, channel, log_time_ns) in messages {
            index.count(channel, log_time_ns);
            channels.insert(channel);
        }
        index.segments.push(Segment {
            place: SegmentPlace::Bytes {
                offset: self.chunk.0,
                length: self.chunk.1 - self.chunk.0,
            },
            start_ns: self.start_ns,
            end_ns: self.end_ns,
            channels: Some(channels.into_iter().collect()),
        });
        Ok(true)
    }

    /// Whether the summary has the times of the chunk's messages, read as `segment`.
    pub fn has_times_of(&self, segment: &Segment) -> bool {
        self.is_consistent && (self.start_ns, self.end_ns) == (segment.start_ns, segment.end_ns)
    }
}
