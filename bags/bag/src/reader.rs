pub(crate) mod chunk;
mod chunk_index;
pub(crate) mod definitions;
mod file_index;
pub(crate) mod indexing;
mod latched;
mod messages;
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
use stored_file::{StoredFile, listed_file, numbered_files};
use times::{Stretch, Times, main_part};

/// A bag that has been opened: its files are indexed, its messages not yet read.
#[derive(Debug)]
pub struct BagReader {
    path: PathBuf,
    index: Arc<Vec<FileIndex>>,
    topics: Vec<TopicInfo>,
    /// The first and the last log time, in ns.
    span: Option<(u64, u64)>,
    /// Those of the recording itself.
    main_span: Option<(u64, u64)>,
    stretches: Vec<Stretch>,
    lost: BTreeMap<String, u64>,
    custom: BTreeMap<String, String>,
    ros_distro: String,
    warnings: Vec<BagWarning>,
}

impl BagReader {
    /// Opens a bag directory, or one of its files: MCAP or sqlite3, as they are or compressed by rosbag2.
    ///
    /// A file with a summary whose indexes agree is not read beyond these; one without (truncated, or not indexed) is
    /// scanned once. A file that is compressed as a whole is decompressed to a temporary file for as long as this reader and
    /// its messages live.
    ///
    /// # Errors
    /// No such path, not a bag, empty, another storage or compression, or no room for a decompressed file. Not an error, but
    /// named in [`warnings`](Self::warnings): a truncated or partly damaged file, a damaged `metadata.yaml`, a file that it
    /// lists and that is missing while others are there, and channels that cannot be read (another encoding than CDR, no
    /// type, a second type on a topic; of protobuf, other types than
    /// [`PROTOBUF_TYPES`](crate::PROTOBUF_TYPES)).
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
                // The recorder was killed when it had just made the bag's next file.
                Err(BagError::Empty { .. }) if is_unfinished && is_one_of_several => {
                    warnings.push(BagWarning::Truncated {
                        file,
                        lost_bytes: 0,
                    });
                }
                Err(error) => return Err(error),
            }
        }

        let mut topics = topics::merged(&mut index);
        for warning in index.iter().flat_map(FileIndex::channel_warnings) {
            // The same of each file of a bag.
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
            topics::take_repeated(&mut topics, &metadata, index.len());
            topics::add_from_metadata(&mut topics, &metadata, &index, &mut warnings);
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
        index.iter().for_each(|file| times.append(&file.times));
        let stretches = times.stretches();
        warnings.extend(BagWarning::of_times(path, &times, &stretches));
        let main = main_part(&stretches);
        Ok(Self {
            path: path.to_owned(),
            index: Arc::new(index),
            topics: topics.into_values().collect(),
            span,
            main_span: main.map(|(part, _)| (part.start_ns, part.end_ns)),
            stretches,
            lost,
            custom,
            ros_distro,
            warnings,
        })
    }

    /// What `custom_data` of the bag's `metadata.yaml` holds under `key`.
    #[must_use]
    pub fn note(&self, key: &str) -> Option<&str> {
        self.custom.get(key).map(String::as_str)
    }

    /// The path that was opened.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics, by name; those without messages too.
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

    /// First and last log time of the recording itself, in ns since the epoch: without the messages that are more than a day
    /// from most others, because of a stamp of zero or a clock that was not set. None for a bag without messages.
    #[must_use]
    pub fn main_span_ns(&self) -> Option<(u64, u64)> {
        self.main_span
    }

    /// The log time that is so long after the beginning of the recording itself ([`main_span_ns`](Self::main_span_ns)), in
    /// ns since the epoch.
    #[must_use]
    pub fn time_at(&self, offset: Duration) -> u64 {
        let start_ns = self.main_span.map_or(0, |(start, _)| start);
        let offset_ns = u64::try_from(offset.as_nanos()).unwrap_or(u64::MAX);
        start_ns.saturating_add(offset_ns)
    }

    /// The gaps of more than ten seconds between messages, in order: log times of the message before and of the one after,
    /// in ns since the epoch. Of a bag with thousands of gaps, the largest.
    pub fn gaps_ns(&self) -> impl Iterator<Item = (u64, u64)> + '_ {
        let pairs = self.stretches.iter().zip(self.stretches.iter().skip(1));
        pairs.map(|(one, next)| (one.end_ns, next.start_ns))
    }

    /// Messages of all topics. Where a file is damaged, those that can be read.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.message_count).sum()
    }

    /// Whether a file ends early (its recorder was killed, or a copy was cut short). Everything up to the last whole
    /// chunk is read.
    #[must_use]
    pub fn truncated(&self) -> bool {
        self.warnings
            .iter()
            .any(|warning| matches!(warning, BagWarning::Truncated { .. }))
    }

    /// What the user should know about the bag.
    #[must_use]
    pub fn warnings(&self) -> &[BagWarning] {
        &self.warnings
    }

    /// All messages, in log-time order. The iterator stands on its own: it opens the files again as it needs them.
    #[must_use]
    pub fn messages(&self) -> Messages {
        Messages::new(Arc::clone(&self.index))
    }

    /// Messages as the files hold them, for who copies them; `select` says which.
    pub(crate) fn stored_messages(
        &self,
        select: impl FnOnce(Messages) -> Messages,
    ) -> StoredMessages {
        StoredMessages(select(self.messages()))
    }

    /// The same message with its topic; none of a channel that is left out.
    pub(crate) fn message_of(&self, stored: &StoredMessage) -> Option<BagMessage> {
        let file = self.index.get(stored.file)?;
        let channel = file.channels.get(&stored.header.channel_id)?;
        Some(BagMessage::new(
            channel,
            &stored.header,
            stored.data.clone(),
        ))
    }

    /// The channels of the files, each with the number of its file, as the files define them.
    pub(crate) fn definitions(
        &self,
    ) -> impl Iterator<Item = (usize, &Arc<mcap::Channel<'static>>)> {
        let files = self.index.iter().enumerate();
        files.flat_map(|(number, file)| file.definitions.values().map(move |c| (number, c)))
    }

    /// What the bag holds, for `bag info`.
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

/// The files of a folder, and its metadata where they can be read.
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
            // There is nothing else to read.
            Err(BagError::Empty { .. }) => Err(BagError::Metadata { path: file, reason }),
            Err(error) => Err(error),
        },
        Err(error) => Err(error),
    }
}

/// Refuses storages and compressions that this crate does not know.
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
