mod frame;
mod loss;
mod survey;

use std::{
    collections::HashMap,
    fmt,
    fs::{self, File},
    io::{BufReader, Read as _, Seek as _, SeekFrom},
    path::{Path, PathBuf},
};

use mcap::records::{Record, op};

use crate::{
    BagError, BagSummary, BagWarning, BagWriter, MessageEncoding, WriterOptions,
    metadata::Metadata,
    reader::{
        check_storage,
        chunk::{RECORD_HEADER_BYTES, Records, decompress, record_header},
        payload,
        record::parse,
        stored_file::{StoredFile, numbered_files},
    },
    writer::LOST_PREFIX,
};
pub use loss::{Loss, Losses};
use survey::{IntactRange, Survey, examine};

/// The result of [`recover`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Recovery {
    /// The new bag.
    pub summary: BagSummary,
    /// The parts of the old bag that it lacks.
    pub losses: Losses,
    /// Truncated files (killed recorder, incomplete copy). `losses` cannot count the bytes after their end.
    pub without_end: Vec<PathBuf>,
    /// Faults of the old bag's files.
    pub warnings: Vec<BagWarning>,
}

impl fmt::Display for Recovery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "recovered {} message(s) of {} topic(s) to {}",
            self.summary.message_count,
            self.summary.topics.len(),
            self.summary.path.display()
        )?;
        for file in &self.without_end {
            writeln!(f, "{} has no end: it was truncated", file.display())?;
        }
        for warning in &self.warnings {
            writeln!(f, "Warning: {warning}")?;
        }
        write!(f, "{}", self.losses)
    }
}

/// Rebuilds the bag folder or `.mcap` file at `input`, truncated or damaged anywhere, as a valid bag at `output`, with
/// indexes, summary and `metadata.yaml`.
///
/// Keeps every chunk that can be decompressed and has a correct checksum, also after a damaged one. Messages outside
/// chunks have no checksum: they are kept as long as each length leads to the next record. Copies the bytes, times and
/// sequence numbers of messages, schemas, channels, the division into files, and notes if readable. Attachments and
/// metadata records count as lost.
///
/// # Errors
/// `input` is not a bag or has sqlite3 files, `output` exists, or a file cannot be read or written.
pub fn recover(input: impl AsRef<Path>, output: impl AsRef<Path>) -> Result<Recovery, BagError> {
    let input = input.as_ref();
    let found = fs::metadata(input).map_err(|source| BagError::io(input, source))?;
    let mut warnings = Vec::new();
    let (files, metadata) = if found.is_dir() {
        // Invalid metadata is rebuilt.
        let metadata = Metadata::read(input).ok().flatten();
        if let Some(metadata) = &metadata {
            check_storage(input, metadata)?;
        }
        let (files, twice) = numbered_files(input)?;
        warnings.extend(twice);
        (files, metadata)
    } else {
        (vec![input.to_owned()], None)
    };

    let mut losses = Losses::default();
    let mut surveys = Vec::new();
    let mut first_error = None;
    for path in files {
        let (stored, warning) = StoredFile::open(&path)?;
        if let Some(BagWarning::CompressedEnd { reason, .. }) = &warning {
            losses.add(
                &path,
                0,
                0,
                0,
                &format!("its compressed end is damaged: {reason}"),
            );
        }
        warnings.extend(warning);
        match examine(&stored, &mut losses) {
            Ok(found) => surveys.push((stored, found)),
            // Other files may still be readable.
            Err(error @ (BagError::Empty { .. } | BagError::NotABag { .. })) => {
                let bytes = fs::metadata(&path).map_or(0, |found| found.len());
                losses.add(&path, 0, bytes, 0, &error.to_string());
                first_error.get_or_insert(error);
            }
            Err(error) => return Err(error),
        }
    }
    if let (true, Some(error)) = (surveys.is_empty(), first_error) {
        return Err(error);
    }

    let mut options = WriterOptions::default();
    let compression = surveys.iter().find_map(|(_, found)| found.compression);
    // Without a chunk, the new bag has the default.
    options.compression = compression.unwrap_or_default();
    // Files that repeat latched messages have them already.
    options.repeats_latched = false;
    let metadata = metadata.as_ref();
    options.ros_distro = metadata.map_or_else(String::new, |old| old.ros_distro.clone());
    let mut writer = BagWriter::create(output, options)?;
    for (key, value) in metadata
        .into_iter()
        .flat_map(|old| old.custom_data.iter().flatten())
    {
        match (key.strip_prefix(LOST_PREFIX), value.parse()) {
            (Some(topic), Ok(count)) => writer.count_lost(topic, count),
            _ => writer.note(key, value),
        }
    }
    let mut is_first = true;
    for (stored, found) in &surveys {
        if !std::mem::take(&mut is_first) {
            writer.split()?;
        }
        Copier::new(stored, found, &mut writer, &mut losses)?.run()?;
    }
    Ok(Recovery {
        summary: writer.finish()?,
        losses,
        without_end: surveys
            .into_iter()
            .filter(|(_, found)| !found.has_end)
            .map(|(stored, _)| stored.path)
            .collect(),
        warnings,
    })
}

/// Copies the undamaged ranges of one file.
struct Copier<'a> {
    path: &'a Path,
    intact: &'a [IntactRange],
    file: BufReader<File>,
    /// The new bag's channel number, by channel id.
    numbers: HashMap<u16, usize>,
    /// Topics of skipped channels, by channel id.
    skipped: HashMap<u16, String>,
    writer: &'a mut BagWriter,
    losses: &'a mut Losses,
}

impl<'a> Copier<'a> {
    fn new(
        stored: &'a StoredFile,
        found: &'a Survey,
        writer: &'a mut BagWriter,
        losses: &'a mut Losses,
    ) -> Result<Self, BagError> {
        let path = stored.path.as_path();
        let file = stored.file().map_err(|source| BagError::io(path, source))?;
        let (mut numbers, mut skipped) = (HashMap::new(), HashMap::new());
        for id in found.definitions.ids() {
            let Some(channel) = found.definitions.channel(id) else {
                continue;
            };
            let topic = channel.topic.clone();
            let name = channel.schema.as_ref().map(|schema| schema.name.as_str());
            if MessageEncoding::of_channel(&channel.message_encoding, name).is_err() {
                skipped.insert(id, topic);
                continue;
            }
            // Outside chunks, definitions have no checksum: an impossible one is skipped, and its messages count as lost.
            match writer.add_channel(channel) {
                Ok(number) => {
                    numbers.insert(id, number);
                }
                Err(
                    BagError::NoType { .. } | BagError::TypeName(_) | BagError::TypeConflict { .. },
                ) => {
                    skipped.insert(id, topic);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(Self {
            path,
            intact: &found.intact,
            file: BufReader::new(file),
            numbers,
            skipped,
            writer,
            losses,
        })
    }

    fn run(mut self) -> Result<(), BagError> {
        for range in self.intact {
            let io = |source| BagError::io(self.path, source);
            self.file.seek(SeekFrom::Start(range.offset)).map_err(io)?;
            let mut at = range.offset;
            while at < range.end {
                at += self.record(range)?;
            }
        }
        Ok(())
    }

    /// Copies the messages of the next record; returns its size in bytes.
    fn record(&mut self, range: &IntactRange) -> Result<u64, BagError> {
        let io = |source| BagError::io(self.path, source);
        let changed = |reason: String| BagError::Chunk {
            path: self.path.to_owned(),
            offset: range.offset,
            reason,
        };
        let mut header = [0; RECORD_HEADER_BYTES as usize];
        self.file.read_exact(&mut header).map_err(io)?;
        let length = record_header(&header).map_or(0, |(_, length)| length);
        let size = RECORD_HEADER_BYTES.saturating_add(length);
        if size > range.end - range.offset {
            return Err(changed("it has changed since it was examined".to_owned()));
        }
        // Fits: bounded by MAX_RECORD_BYTES and the file's size.
        let mut body = vec![0; length as usize];
        self.file.read_exact(&mut body).map_err(io)?;
        if !range.is_chunk {
            self.message(&body)?;
            return Ok(size);
        }
        let records = decompress(&body).map_err(changed)?;
        for record in Records::new(records) {
            let record = record.map_err(|reason| BagError::Chunk {
                path: self.path.to_owned(),
                offset: range.offset,
                reason,
            })?;
            if record.opcode == op::MESSAGE {
                self.message(&record.body)?;
            }
        }
        Ok(size)
    }

    fn message(&mut self, body: &[u8]) -> Result<(), BagError> {
        let parsed = parse(op::MESSAGE, body);
        let Ok(Record::Message { header, data }) = parsed else {
            self.losses.messages += 1;
            return Ok(());
        };
        let Some(number) = self.numbers.get(&header.channel_id) else {
            self.losses.messages += 1;
            if let Some(topic) = self.skipped.get(&header.channel_id) {
                *self.losses.by_topic.entry(topic.clone()).or_default() += 1;
            }
            return Ok(());
        };
        // The new bag's metadata declares no compressed messages.
        let plain = match payload::decompress(&data) {
            Some(Ok(plain)) => Some(plain),
            None => None,
            Some(Err(_)) => {
                self.losses.messages += 1;
                return Ok(());
            }
        };
        match self
            .writer
            .copy(*number, header, plain.as_deref().unwrap_or(&data))
        {
            Err(BagError::LogTime { .. }) => {
                self.losses.messages += 1;
                Ok(())
            }
            written => written,
        }
    }
}

#[cfg(test)]
mod tests;
