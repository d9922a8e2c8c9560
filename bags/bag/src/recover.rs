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
        chunk::{RECORD_HEADER_BYTES, Records, decompressed, record_header},
        payload,
        record::parse,
        stored_file::{StoredFile, numbered_files},
    },
    writer::LOST_PREFIX,
};
pub use loss::{Loss, Losses};
use survey::{Stretch, Survey, survey};

/// What came of [`recover`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Recovery {
    /// The new bag.
    pub summary: BagSummary,
    /// What of the old one is not in it.
    pub losses: Losses,
    /// Files that had no end: their recorder was killed, or a copy was cut short. What is behind their last byte is
    /// nowhere and not counted in `losses`.
    pub without_end: Vec<PathBuf>,
    /// What the user should know of its files.
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

/// Writes a sound bag at `output`, with indexes, summary and `metadata.yaml`, of what is left of the bag folder or
/// `.mcap` at `input`: cut off at any byte, or damaged at any.
///
/// Of each file, every chunk is kept that can be decompressed and whose checksum is right, also behind a damaged one;
/// messages outside chunks, which have no checksum, as long as their lengths lead from one to the next. Bytes of
/// messages, their times and sequence numbers, schemas and channels with their metadata stay as they were, each file stays
/// a file, and what `metadata.yaml` notes of the bag stays where it can be read. Attachments and metadata records are not
/// copied, which counts as a loss.
///
/// # Errors
/// No bag at all, sqlite3 files, an `output` that exists, or files that cannot be read or written.
pub fn recover(input: impl AsRef<Path>, output: impl AsRef<Path>) -> Result<Recovery, BagError> {
    let input = input.as_ref();
    let found = fs::metadata(input).map_err(|source| BagError::io(input, source))?;
    let mut warnings = Vec::new();
    let (files, metadata) = if found.is_dir() {
        // Metadata that cannot be read is one of the things that are made anew.
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
        match survey(&stored, &mut losses) {
            Ok(found) => surveys.push((stored, found)),
            // One file of several; the others are a bag still.
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
    options.compression = compression.unwrap_or_default();
    // The files have them already, if they were written so.
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

/// Copies the sound stretches of one file.
struct Copier<'a> {
    path: &'a Path,
    stretches: &'a [Stretch],
    file: BufReader<File>,
    /// Number in the new bag of each channel of the file.
    numbers: HashMap<u16, usize>,
    /// Topics of the channels that the new bag does not have.
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
            // Outside of chunks nothing says whether a definition is what was written: one that cannot be true is
            // left out, and its messages are counted as lost.
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
            stretches: &found.stretches,
            file: BufReader::new(file),
            numbers,
            skipped,
            writer,
            losses,
        })
    }

    fn run(mut self) -> Result<(), BagError> {
        for stretch in self.stretches {
            let io = |source| BagError::io(self.path, source);
            self.file
                .seek(SeekFrom::Start(stretch.offset))
                .map_err(io)?;
            let mut at = stretch.offset;
            while at < stretch.end {
                at += self.record(stretch)?;
            }
        }
        Ok(())
    }

    /// Copies the messages of the record that comes next; gives its size, in bytes.
    fn record(&mut self, stretch: &Stretch) -> Result<u64, BagError> {
        let io = |source| BagError::io(self.path, source);
        let changed = |reason: String| BagError::Chunk {
            path: self.path.to_owned(),
            offset: stretch.offset,
            reason,
        };
        let mut header = [0; RECORD_HEADER_BYTES as usize];
        self.file.read_exact(&mut header).map_err(io)?;
        let length = record_header(&header).map_or(0, |(_, length)| length);
        let size = RECORD_HEADER_BYTES.saturating_add(length);
        if size > stretch.end - stretch.offset {
            return Err(changed("it has changed since it was surveyed".to_owned()));
        }
        // The survey held the record to MAX_RECORD_BYTES and to the file's size.
        let mut body = vec![0; length as usize];
        self.file.read_exact(&mut body).map_err(io)?;
        if !stretch.is_chunk {
            self.message(&body)?;
            return Ok(size);
        }
        let records = decompressed(&body).map_err(changed)?;
        for record in Records::new(records) {
            let record = record.map_err(|reason| BagError::Chunk {
                path: self.path.to_owned(),
                offset: stretch.offset,
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
        // The new bag's metadata say nothing of compressed messages.
        let plain = match payload::decompressed(&data) {
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
