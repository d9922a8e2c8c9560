pub(crate) mod chunk;
mod chunk_index;
pub(crate) mod definitions;
mod file_index;
pub(crate) mod indexing;
mod latched;
mod messages;
mod passes;
pub(crate) mod payload;
pub(crate) mod record;
mod scan;
mod sqlite;
pub(crate) mod stored_file;
pub(crate) mod times;
mod topics;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use crate::{
    BagError, BagSummary, BagWarning, TopicInfo, TopicSummary,
    metadata::Metadata,
    writer::{LOST_PREFIX, REPEATED_PREFIX},
};
use file_index::FileIndex;
pub use messages::{BagMessage, Messages};
pub(crate) use messages::{StoredMessage, StoredMessages};
use passes::{Passes, Spans};
use stored_file::{StoredFile, listed_file, numbered_files};
use times::{Stretch, Times, find_main_part};

/// An open bag: its files are indexed, its messages not yet read.
#[derive(Debug)]
pub struct BagReader {
    path: PathBuf,
    index: Arc<Vec<FileIndex>>,
    topics: Vec<TopicInfo>,
    /// First and last log time \[ns\].
    span: Option<(u64, u64)>,
    /// First and last log time of the recording itself \[ns\].
    main_span: Option<(u64, u64)>,
    stretches: Vec<Stretch>,
    unbroken: Spans,
    doubled: Spans,
    lost: BTreeMap<String, u64>,
    custom: BTreeMap<String, String>,
    ros_distro: String,
    warnings: Vec<BagWarning>,
}

impl BagReader {
    /// Opens a bag folder, or one of its files: MCAP or sqlite3, plain or compressed by rosbag2.
    ///
    /// Of a file with a consistent summary, only the indexes are read; a file without one is scanned once. A compressed file
    /// is decompressed to a temporary file, which is deleted with this reader and its messages.
    ///
    /// # Errors
    /// The path is missing, not a bag or empty, the storage or compression is unknown, or a decompressed file has no room.
    /// [`warnings`](Self::warnings) names what can be skipped: truncated or damaged files, invalid metadata, single missing
    /// files, and unreadable channels (without a type, with a second type, in an encoding other than CDR, except
    /// Foxglove's pictures in protobuf).
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let found = fs::metadata(path).map_err(|source| BagError::io(path, source))?;
        let mut warnings = Vec::new();
        let (files, metadata) = if found.is_dir() {
            files_of(path, &mut warnings)?
        } else {
            (vec![path.to_owned()], None)
        };
        let (is_unfinished, is_one_of_several) = (metadata.is_none(), files.len() > 1);
        let mut index = Vec::with_capacity(files.len());
        for file in files {
            let indexed = StoredFile::open(&file).and_then(|(stored, warning)| {
                warnings.extend(warning);
                indexing::index(&stored)
            });
            match indexed {
                Ok((file_index, file_warnings)) => {
                    index.push(file_index);
                    warnings.extend(file_warnings);
                }
                // The recorder was killed just after it created this file.
                Err(BagError::Empty { .. }) if is_unfinished && is_one_of_several => {
                    warnings.push(BagWarning::Truncated {
                        file,
                        lost_bytes: 0,
                    });
                }
                Err(error) => return Err(error),
            }
        }

        let mut topics = topics::merge_topics(&mut index);
        for warning in index.iter().flat_map(FileIndex::channel_warnings) {
            // All files of a bag may have the same fault.
            if !warnings.contains(&warning) {
                warnings.push(warning);
            }
        }
        let counted: u64 = topics.values().map(|topic| topic.message_count).sum();
        let mut lost = BTreeMap::new();
        let mut custom = BTreeMap::new();
        let mut ros_distro = String::new();
        if let Some(metadata) = metadata {
            let skipped = index.iter().flat_map(|file| file.skipped.values());
            let skipped: u64 = skipped.map(|channel| channel.messages).sum();
            if metadata.message_count != counted + skipped {
                warnings.push(BagWarning::CountDiffers {
                    dir: path.to_owned(),
                    metadata: metadata.message_count,
                    files: counted + skipped,
                });
            }
            topics::subtract_repetitions(&mut topics, &metadata, index.len());
            topics::add_from_metadata(&mut topics, &metadata, &index, &mut warnings);
            // Older versions have no `custom_data`.
            for (key, count) in metadata.custom_data.unwrap_or_default() {
                match (key.strip_prefix(LOST_PREFIX), count.parse()) {
                    (Some(topic), Ok(count)) => {
                        lost.insert(topic.to_owned(), count);
                    }
                    _ if key.starts_with(REPEATED_PREFIX) => {}
                    _ => {
                        custom.insert(key, count);
                    }
                }
            }
            ros_distro = metadata.ros_distro;
        }
        let span = index.iter().filter_map(|file| file.span).reduce(
            |(start, end), (next_start, next_end)| (start.min(next_start), end.max(next_end)),
        );
        let mut times = Times::default();
        let mut passes = Passes::default();
        for file in &index {
            times.append(&file.times);
            let channels = file.channels.values();
            let channels = channels.filter(|channel| !channel.is_latched);
            let channels = channels.map(|channel| (&channel.topic.name, &channel.times));
            passes.append(&file.passes, channels);
        }
        let (unbroken, doubled) = passes.spans();
        let stretches = times.stretches();
        warnings.extend(BagWarning::of_times(path, &times, &stretches));
        let main = find_main_part(&stretches);
        Ok(Self {
            path: path.to_owned(),
            index: Arc::new(index),
            topics: topics.into_values().collect(),
            span,
            main_span: main.map(|(part, _)| (part.start_ns, part.end_ns)),
            stretches,
            unbroken,
            doubled,
            lost,
            custom,
            ros_distro,
            warnings,
        })
    }

    /// The note `key`: a value of `custom_data` in `metadata.yaml`.
    #[must_use]
    pub fn note(&self, key: &str) -> Option<&str> {
        self.custom.get(key).map(String::as_str)
    }

    /// The path of the bag.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics, sorted by name, including those without messages.
    #[must_use]
    pub fn topics(&self) -> &[TopicInfo] {
        &self.topics
    }

    /// The topic of this name.
    #[must_use]
    pub fn topic(&self, name: &str) -> Option<&TopicInfo> {
        self.topics.iter().find(|topic| &*topic.name == name)
    }

    /// Log time of the first message in ns since the epoch; 0 for a bag without messages.
    #[must_use]
    pub fn start_ns(&self) -> u64 {
        self.span.map_or(0, |(start, _)| start)
    }

    /// Log time of the last message in ns since the epoch; 0 for a bag without messages.
    #[must_use]
    pub fn end_ns(&self) -> u64 {
        self.span.map_or(0, |(_, end)| end)
    }

    /// The log time at this offset from the start of the recording itself, in ns since the epoch. Messages more than a day
    /// from most others, which have invalid stamps, are not part of it.
    #[must_use]
    pub fn time_at(&self, offset: Duration) -> u64 {
        let start_ns = self.main_span.map_or(0, |(start, _)| start);
        // Saturates at 584 years.
        let offset_ns = u64::try_from(offset.as_nanos()).unwrap_or(u64::MAX);
        start_ns.saturating_add(offset_ns)
    }

    /// Gaps of more than ten seconds, in order: log times of the messages before and after, in ns since the epoch. A bag with
    /// thousands of gaps returns only the largest.
    pub fn gaps_ns(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        let pairs = self.stretches.iter().zip(self.stretches.iter().skip(1));
        pairs.map(|(one, next)| (one.end_ns, next.start_ns))
    }

    /// Spans of log time (first and last, in ns since the epoch, in order) without a gap of more than ten seconds and without
    /// a backward step of the recorder's clock. The last message of a span and the first of the next are not neighbours.
    /// Latched topics are ignored.
    #[must_use]
    pub fn unbroken_ns(&self) -> &[(u64, u64)] {
        &self.unbroken
    }

    /// Whether this log time was recorded twice, because the recorder's clock stepped back by more than ten seconds. The true
    /// order of such messages is unknown.
    #[must_use]
    pub fn is_doubled(&self, log_time_ns: u64) -> bool {
        let begun = self
            .doubled
            .partition_point(|(start_ns, _)| *start_ns <= log_time_ns);
        let last = begun.checked_sub(1).and_then(|last| self.doubled.get(last));
        last.is_some_and(|(_, end_ns)| log_time_ns <= *end_ns)
    }

    /// Number of messages in all topics; in damaged files, of those that can be read.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.message_count).sum()
    }

    /// Whether a file ends early (killed recorder, incomplete copy). Messages up to its last whole chunk are read.
    #[must_use]
    pub fn truncated(&self) -> bool {
        self.warnings
            .iter()
            .any(|warning| matches!(warning, BagWarning::Truncated { .. }))
    }

    /// Faults of the bag that do not prevent reading.
    #[must_use]
    pub fn warnings(&self) -> &[BagWarning] {
        &self.warnings
    }

    /// All messages, in log-time order. The iterator opens the files itself and does not borrow the reader.
    #[must_use]
    pub fn messages(&self) -> Messages {
        Messages::new(Arc::clone(&self.index))
    }

    /// Stored messages, for copies; `select` limits them.
    pub(crate) fn stored_messages(
        &self,
        select: impl FnOnce(Messages) -> Messages,
    ) -> StoredMessages {
        StoredMessages(select(self.messages()))
    }

    /// The message with its topic; `None` if its channel is skipped.
    pub(crate) fn message_of(&self, stored: &StoredMessage) -> Option<BagMessage> {
        let file = self.index.get(stored.file)?;
        let channel = file.channels.get(&stored.header.channel_id)?;
        Some(BagMessage::new(
            channel,
            &stored.header,
            stored.data.clone(),
        ))
    }

    /// The channels as the files define them, each with the number of its file.
    pub(crate) fn definitions(
        &self,
    ) -> impl Iterator<Item = (usize, &Arc<mcap::Channel<'static>>)> {
        let files = self.index.iter().enumerate();
        files.flat_map(|(number, file)| file.definitions.values().map(move |c| (number, c)))
    }

    /// The contents of the bag, for `bag info`.
    #[must_use]
    pub fn summary(&self) -> BagSummary {
        let compressions: BTreeSet<&str> = self
            .index
            .iter()
            .flat_map(|file| &file.compressions)
            .map(|name| if name.is_empty() { "none" } else { name })
            .collect();
        let storages: BTreeSet<&str> = self.index.iter().map(|file| file.storage).collect();
        BagSummary {
            path: self.path.clone(),
            files: self
                .index
                .iter()
                .map(|file| file.path().to_owned())
                .collect(),
            size_bytes: self.index.iter().map(|file| file.size_bytes).sum(),
            start_ns: self.start_ns(),
            end_ns: self.end_ns(),
            main_span_ns: self.main_span,
            storage: storages.into_iter().collect::<Vec<_>>().join(", "),
            message_count: self.message_count(),
            topics: self
                .topics
                .iter()
                .map(|topic| TopicSummary {
                    name: topic.name.to_string(),
                    type_name: topic.type_name.to_string(),
                    serialization_format: topic.encoding.as_str().to_owned(),
                    message_count: topic.message_count,
                })
                .collect(),
            lost: self.lost.clone(),
            compression: if compressions.is_empty() {
                "none".to_owned()
            } else {
                compressions.into_iter().collect::<Vec<_>>().join(", ")
            },
            ros_distro: self.ros_distro.clone(),
            notes: self.custom.clone(),
            warnings: self.warnings.clone(),
        }
    }
}

/// The files of a folder, and its metadata if valid.
fn files_of(
    dir: &Path,
    warnings: &mut Vec<BagWarning>,
) -> Result<(Vec<PathBuf>, Option<Metadata>), BagError> {
    let mut by_name = || -> Result<Vec<PathBuf>, BagError> {
        let (files, twice) = numbered_files(dir)?;
        warnings.extend(twice);
        Ok(files)
    };
    match Metadata::read(dir) {
        Ok(Some(metadata)) => {
            let files = listed_files(dir, &metadata, warnings)?;
            Ok((files, Some(metadata)))
        }
        Ok(None) => {
            let files = by_name()?;
            warnings.push(BagWarning::NoMetadata {
                dir: dir.to_owned(),
            });
            Ok((files, None))
        }
        Err(BagError::Metadata { path: file, reason }) => match by_name() {
            Ok(files) => {
                warnings.push(BagWarning::BadMetadata { file, reason });
                Ok((files, None))
            }
            // Without a file, the invalid metadata is the fault to report.
            Err(BagError::Empty { .. }) => Err(BagError::Metadata { path: file, reason }),
            Err(error) => Err(error),
        },
        Err(error) => Err(error),
    }
}

/// Rejects unknown storages and compressions.
pub(crate) fn check_storage(dir: &Path, metadata: &Metadata) -> Result<(), BagError> {
    if !["mcap", "sqlite3"].contains(&metadata.storage_identifier.as_str()) {
        return Err(BagError::Storage {
            path: dir.to_owned(),
            storage: metadata.storage_identifier.clone(),
        });
    }
    let mode = metadata.compression_mode.to_lowercase();
    let is_plain = mode.is_empty() || mode == "none";
    if !is_plain && metadata.compression_format != "zstd" {
        return Err(BagError::RosbagCompression {
            path: dir.to_owned(),
            mode,
            format: metadata.compression_format.clone(),
        });
    }
    Ok(())
}

/// The files that `metadata.yaml` lists, in its order.
fn listed_files(
    dir: &Path,
    metadata: &Metadata,
    warnings: &mut Vec<BagWarning>,
) -> Result<Vec<PathBuf>, BagError> {
    check_storage(dir, metadata)?;
    let listed = &metadata.relative_file_paths;
    let Some(first) = listed.first() else {
        return Err(BagError::Empty {
            path: dir.to_owned(),
            reason: "its metadata.yaml lists no files",
        });
    };
    let mut files = Vec::with_capacity(listed.len());
    for file in listed {
        match listed_file(dir, file) {
            Some(found) => files.push(found),
            None => warnings.push(BagWarning::MissingFile {
                dir: dir.to_owned(),
                file: file.clone(),
            }),
        }
    }
    if files.is_empty() {
        return Err(BagError::MissingFile {
            dir: dir.to_owned(),
            file: first.clone(),
        });
    }
    Ok(files)
}

#[cfg(test)]
mod tests;
