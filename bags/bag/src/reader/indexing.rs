use std::{
    fs::File,
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::Path,
};

use mcap::{
    MAGIC, Summary,
    records::{Statistics, op},
    sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};

use super::{
    chunk::{MAX_RECORD_BYTES, RECORD_HEADER_BYTES, record_header},
    chunk_index,
    file_index::FileIndex,
    record::bytes_after_fields,
    scan::Scan,
    sqlite,
    stored_file::{SQLITE_MAGIC, StoredFile},
};
use crate::{BagError, BagWarning};

/// Indexes a file by its summary if that is consistent, otherwise by reading all of it.
pub(super) fn index(stored: &StoredFile) -> Result<(FileIndex, Vec<BagWarning>), BagError> {
    let path = stored.path.as_path();
    let io = |source| BagError::io(path, source);
    let mut file = stored.file().map_err(io)?;
    file.seek(SeekFrom::Start(0)).map_err(io)?;
    let size_bytes = file.metadata().map_err(io)?.len();
    if detect_storage(&mut file, path, size_bytes)? == Storage::Sqlite {
        return sqlite::index(stored, size_bytes);
    }
    let mut index = FileIndex::empty(stored, size_bytes, "mcap");
    let mut warnings = Vec::new();
    let mut scan = Scan::new(file, path, size_bytes);
    let summary = read_summary(&mut scan.file, size_bytes).map_err(io)?;
    let chunks = match &summary {
        Ok(Some(summary)) => chunk_index::read(&mut scan.file, &summary.chunk_indexes)
            .map_err(io)?
            .map(Some),
        Ok(None) => Ok(None),
        Err(reason) => Err(reason.clone()),
    };
    match (summary, chunks) {
        (Ok(Some(summary)), Ok(Some(chunks))) => {
            for channel in summary.channels.values() {
                index.add_channel(channel);
            }
            let places: Vec<(u64, u64)> = chunks.iter().map(|chunk| chunk.place).collect();
            let mut inconsistent = 0;
            for chunk in chunks {
                index.compressions.insert(chunk.compression.clone());
                if !chunk.take(&mut scan.file, &mut index).map_err(io)? {
                    let previous = index.segments.len();
                    scan.scan_chunk(chunk.chunk, &mut index)?;
                    let read = index.segments.get(previous);
                    if read.is_some_and(|read| !chunk.has_times_of(read)) {
                        inconsistent += 1;
                    }
                }
            }
            scan.scan_gaps(&mut index, places)?;
            warnings.extend(find_differences(
                &index,
                summary.stats.as_ref(),
                inconsistent,
            ));
        }
        (_, no_summary) => {
            let has_end = has_end_magic(&mut scan.file, size_bytes).map_err(io)?;
            let outcome = scan.scan_all(&mut index)?;
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
    index.segments.sort_by_key(|segment| segment.place);
    let mut all = scan.into_warnings();
    all.append(&mut warnings);
    Ok((index, all))
}

/// Differences between summary and messages. `inconsistent`: number of chunks whose indexes differ.
fn find_differences(
    index: &FileIndex,
    stats: Option<&Statistics>,
    inconsistent: usize,
) -> Option<BagWarning> {
    let mut differences = Vec::new();
    if inconsistent > 0 {
        differences.push(format!(
            "the times of {inconsistent} chunk(s) differ from their messages'"
        ));
    }
    let readable = index
        .channels
        .values()
        .map(|channel| channel.topic.message_count);
    let skipped = index.skipped.values().map(|skipped| skipped.messages);
    let counted: u64 = readable.chain(skipped).sum();
    if let Some(stats) = stats {
        if stats.message_count != counted {
            let named = stats.message_count;
            differences.push(format!(
                "it counts {named} messages, the file has {counted}"
            ));
        }
        // The summary's times include skipped messages.
        let named = (stats.message_start_time, stats.message_end_time);
        if index.skipped.is_empty() && index.span.is_some_and(|span| span != named) {
            differences.push("its first and last log times are not those of the messages".into());
        }
    }
    (!differences.is_empty()).then(|| BagWarning::WrongSummary {
        file: index.path().to_owned(),
        reason: differences.join("; "),
    })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Storage {
    Mcap,
    Sqlite,
}

/// Detects the storage of a bag's file by its first bytes.
pub(crate) fn detect_storage(
    file: &mut File,
    path: &Path,
    size_bytes: u64,
) -> Result<Storage, BagError> {
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
        Ok(Storage::Mcap)
    } else if front.starts_with(SQLITE_MAGIC) {
        Ok(Storage::Sqlite)
    } else if front.starts_with(b"#ROSBAG") {
        not_a_bag("it is a ROS 1 bag; convert it with `rosbags-convert`")
    } else if MAGIC.starts_with(&front) {
        not_a_bag("it ends within the first bytes of an MCAP file")
    } else {
        not_a_bag("expected an MCAP or sqlite3 file of rosbag2, or a directory with one")
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

/// Checks the summary's records. The library would read any record there, such as an attachment or a chunk, and trust
/// its lengths.
fn check_summary_records(
    file: &mut BufReader<File>,
    size_bytes: u64,
) -> std::io::Result<Result<(), String>> {
    const FOOTER_BODY: u64 = 20;
    const FOOTER: u64 = RECORD_HEADER_BYTES + FOOTER_BODY;
    let Some(footer_at) = size_bytes.checked_sub(FOOTER + MAGIC.len() as u64) else {
        return Ok(Ok(()));
    };
    file.seek(SeekFrom::Start(footer_at))?;
    let mut footer = [0; FOOTER as usize];
    file.read_exact(&mut footer)?;
    let (header, body) = footer.split_at(RECORD_HEADER_BYTES as usize);
    let is_footer = record_header(header) == Some((op::FOOTER, FOOTER_BODY));
    let (true, Some(start)) = (is_footer, body.first_chunk().copied()) else {
        return Ok(Ok(()));
    };
    let mut at = u64::from_le_bytes(start);
    if at == 0 {
        return Ok(Ok(()));
    }
    if at > footer_at {
        return Ok(Err(format!(
            "it begins at byte {at}, after the end of the file"
        )));
    }
    file.seek(SeekFrom::Start(at))?;
    while footer_at - at >= RECORD_HEADER_BYTES {
        let mut header = [0; RECORD_HEADER_BYTES as usize];
        file.read_exact(&mut header)?;
        let Some((opcode, length)) = record_header(&header) else {
            return Ok(Err(format!("it has no record at byte {at}")));
        };
        let belongs = matches!(
            opcode,
            op::SCHEMA
                | op::CHANNEL
                | op::CHUNK_INDEX
                | op::ATTACHMENT_INDEX
                | op::METADATA_INDEX
                | op::STATISTICS
                | op::SUMMARY_OFFSET
        );
        let room = footer_at - at - RECORD_HEADER_BYTES;
        if !belongs || length > room.min(MAX_RECORD_BYTES) {
            return Ok(Err(format!(
                "the record at byte {at} (opcode {opcode}, {length} bytes) is not allowed there"
            )));
        }
        // Fits: bounded by MAX_RECORD_BYTES.
        let mut body = vec![0; length as usize];
        file.read_exact(&mut body)?;
        if bytes_after_fields(opcode, &body).is_none() {
            return Ok(Err(format!(
                "a length in the record at byte {at} (opcode {opcode}) exceeds it"
            )));
        }
        at += RECORD_HEADER_BYTES + length;
    }
    Ok(Ok(()))
}

/// The file's summary; `None` if it is missing or has no index. The inner error is its fault.
fn read_summary(
    file: &mut BufReader<File>,
    size_bytes: u64,
) -> std::io::Result<Result<Option<Summary>, String>> {
    if let Err(reason) = check_summary_records(file, size_bytes)? {
        return Ok(Err(reason));
    }
    file.seek(SeekFrom::Start(0))?;
    let options = SummaryReaderOptions::default()
        .with_file_size(size_bytes)
        // Fits: ROS 2 supports only 64-bit targets.
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
    let mut ranges = Vec::with_capacity(summary.chunk_indexes.len());
    for chunk in &summary.chunk_indexes {
        let end = chunk
            .chunk_start_offset
            .checked_add(chunk.chunk_length)
            .and_then(|end| end.checked_add(chunk.message_index_length))
            .filter(|end| *end <= size_bytes && chunk.chunk_length <= MAX_RECORD_BYTES);
        let Some(end) = end else {
            return Ok(Err(format!(
                "it puts a chunk at byte {}, beyond the end of the file",
                chunk.chunk_start_offset
            )));
        };
        ranges.push((chunk.chunk_start_offset, end));
    }
    ranges.sort_unstable();
    let mut previous = 0;
    for (at, end) in ranges {
        if at < previous {
            return Ok(Err(format!("it puts two chunks at byte {at}")));
        }
        previous = end;
    }
    let described = summary.channels.len() as u64;
    if described != u64::from(stats.channel_count) {
        return Ok(Err(format!(
            "it counts {} channels and describes {described}",
            stats.channel_count
        )));
    }
    Ok(Ok(Some(summary)))
}
