pub(crate) mod chunk;
pub(crate) mod definitions;
mod file_index;
pub(crate) mod indexing;
mod messages;
mod scan;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use crate::{
    BagError, BagSummary, BagWarning, CDR, Schema, TopicInfo, TopicSummary, metadata::Metadata,
    schema::canonical_type_name, writer::LOST_PREFIX,
};
use file_index::FileIndex;
pub use messages::{BagMessage, Messages};
pub(crate) use messages::{StoredMessage, StoredMessages};

/// A bag that has been opened: its files are indexed, its messages not yet read.
#[derive(Debug)]
pub struct BagReader {
    path: PathBuf,
    index: Arc<Vec<FileIndex>>,
    topics: Vec<TopicInfo>,
    /// The first and the last log time, in ns.
    span: Option<(u64, u64)>,
    lost: BTreeMap<String, u64>,
    custom: BTreeMap<String, String>,
    ros_distro: String,
    warnings: Vec<BagWarning>,
}

impl BagReader {
    /// Opens a bag directory or one `.mcap` file.
    ///
    /// A file with a summary is not read beyond it; one without (truncated, or not indexed) is scanned once.
    ///
    /// # Errors
    /// No such path, not a bag, empty, another storage than MCAP, rosbag2's file or message compression, messages
    /// in another encoding than CDR, or a topic with two types. A truncated or partly damaged file is no error, nor is a
    /// damaged `metadata.yaml` beside `.mcap` files: see [`warnings`](Self::warnings).
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let found = fs::metadata(path).map_err(|source| BagError::io(path, source))?;
        let mut warnings = Vec::new();
        let (files, metadata) = if found.is_dir() {
            match Metadata::read(path) {
                Ok(Some(metadata)) => (listed_files(path, &metadata)?, Some(metadata)),
                Ok(None) => {
                    warnings.push(BagWarning::NoMetadata {
                        dir: path.to_owned(),
                    });
                    (mcap_files(path)?, None)
                }
                Err(BagError::Metadata { path: file, reason }) => match mcap_files(path) {
                    Ok(files) => {
                        warnings.push(BagWarning::BadMetadata { file, reason });
                        (files, None)
                    }
                    // There is nothing else to read.
                    Err(BagError::Empty { .. }) => {
                        return Err(BagError::Metadata { path: file, reason });
                    }
                    Err(error) => return Err(error),
                },
                Err(error) => return Err(error),
            }
        } else {
            (vec![path.to_owned()], None)
        };
        let (is_unfinished, is_one_of_several) = (metadata.is_none(), files.len() > 1);
        let mut index = Vec::with_capacity(files.len());
        for file in files {
            match indexing::index(&file) {
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

        let mut topics = merged_topics(path, &index)?;
        let counted: u64 = topics.values().map(|topic| topic.message_count).sum();
        let mut lost = BTreeMap::new();
        let mut custom = BTreeMap::new();
        let mut ros_distro = String::new();
        if let Some(metadata) = metadata {
            if metadata.message_count != counted {
                warnings.push(BagWarning::CountDiffers {
                    dir: path.to_owned(),
                    metadata: metadata.message_count,
                    files: counted,
                });
            }
            add_from_metadata(&mut topics, &metadata, path)?;
            for (key, count) in metadata.custom_data.unwrap_or_default() {
                match (key.strip_prefix(LOST_PREFIX), count.parse()) {
                    (Some(topic), Ok(count)) => {
                        lost.insert(topic.to_owned(), count);
                    }
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
        Ok(Self {
            path: path.to_owned(),
            index: Arc::new(index),
            topics: topics.into_values().collect(),
            span,
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
        BagSummary {
            path: self.path.clone(),
            files: self.index.iter().map(|file| file.path.clone()).collect(),
            size_bytes: self.index.iter().map(|file| file.size_bytes).sum(),
            start_ns: self.start_ns(),
            end_ns: self.end_ns(),
            message_count: self.message_count(),
            topics: self
                .topics
                .iter()
                .map(|topic| TopicSummary {
                    name: topic.name.to_string(),
                    type_name: topic.type_name.to_string(),
                    serialization_format: CDR.to_owned(),
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

/// Refuses what is not stored as MCAP, or hidden from an MCAP reader by rosbag2's own compression.
pub(crate) fn check_storage(dir: &Path, metadata: &Metadata) -> Result<(), BagError> {
    if metadata.storage_identifier != "mcap" {
        return Err(BagError::Storage {
            path: dir.to_owned(),
            storage: metadata.storage_identifier.clone(),
        });
    }
    let mode = metadata.compression_mode.to_lowercase();
    if !mode.is_empty() && mode != "none" {
        return Err(BagError::RosbagCompression {
            path: dir.to_owned(),
            mode,
            format: metadata.compression_format.clone(),
        });
    }
    Ok(())
}

/// The files that `metadata.yaml` lists, in its order.
fn listed_files(dir: &Path, metadata: &Metadata) -> Result<Vec<PathBuf>, BagError> {
    check_storage(dir, metadata)?;
    if metadata.relative_file_paths.is_empty() {
        return Err(BagError::Empty {
            path: dir.to_owned(),
            reason: "its metadata.yaml lists no files",
        });
    }
    metadata
        .relative_file_paths
        .iter()
        .map(|file| {
            // A bag is its own directory: a path that leads elsewhere is taken by its name, as rosbag2 does for
            // bags that were moved.
            let inside = file
                .file_name()
                .map(|name| dir.join(name))
                .filter(|path| path.exists());
            inside.ok_or_else(|| BagError::MissingFile {
                dir: dir.to_owned(),
                file: file.clone(),
            })
        })
        .collect()
}

/// The `.mcap` files of a directory, in the order in which a recorder numbers them (`bag_2` before `bag_10`).
pub(crate) fn mcap_files(dir: &Path) -> Result<Vec<PathBuf>, BagError> {
    let mut files = Vec::new();
    for entry in fs::read_dir(dir).map_err(|source| BagError::io(dir, source))? {
        let path = entry.map_err(|source| BagError::io(dir, source))?.path();
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("mcap") => files.push(path),
            Some("db3") => {
                return Err(BagError::Storage {
                    path: dir.to_owned(),
                    storage: "sqlite3".to_owned(),
                });
            }
            _ => {}
        }
    }
    if files.is_empty() {
        return Err(BagError::Empty {
            path: dir.to_owned(),
            reason: "it has no metadata.yaml and no .mcap file",
        });
    }
    files.sort_by_key(|path| {
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let number = stem
            .rsplit('_')
            .next()
            .and_then(|digits| digits.parse::<u64>().ok());
        (number, stem)
    });
    Ok(files)
}

/// The topics of all files, by name.
fn merged_topics(
    path: &Path,
    index: &[FileIndex],
) -> Result<BTreeMap<Arc<str>, TopicInfo>, BagError> {
    let mut topics: BTreeMap<Arc<str>, TopicInfo> = BTreeMap::new();
    for channel in index.iter().flat_map(|file| file.channels.values()) {
        match topics.get_mut(&channel.name) {
            Some(known) if known.type_name != channel.type_name => {
                return Err(BagError::TypeConflict {
                    path: path.to_owned(),
                    topic: channel.name.to_string(),
                    first: known.type_name.to_string(),
                    second: channel.type_name.to_string(),
                });
            }
            Some(known) => known.message_count += channel.message_count,
            None => {
                topics.insert(Arc::clone(&channel.name), channel.clone());
            }
        }
    }
    Ok(topics)
}

/// Adds what only `metadata.yaml` knows: topics without a message, QoS and type hashes that the files
/// do not name.
fn add_from_metadata(
    topics: &mut BTreeMap<Arc<str>, TopicInfo>,
    metadata: &Metadata,
    path: &Path,
) -> Result<(), BagError> {
    for listed in &metadata.topics_with_message_count {
        let listed = &listed.topic_metadata;
        if listed.serialization_format != CDR {
            return Err(BagError::MessageEncoding {
                path: path.to_owned(),
                topic: listed.name.clone(),
                encoding: listed.serialization_format.clone(),
            });
        }
        let qos_yaml: Arc<str> = match &listed.offered_qos_profiles {
            serde_yaml_ng::Value::Null => "".into(),
            serde_yaml_ng::Value::String(text) => text.as_str().into(),
            profiles => serde_yaml_ng::to_string(profiles)
                .unwrap_or_default()
                .into(),
        };
        let type_hash: Arc<str> = listed.type_description_hash.as_str().into();
        let name: Arc<str> = listed.name.as_str().into();
        if let Some(known) = topics.get_mut(&name) {
            if known.qos_yaml.is_empty() {
                known.qos_yaml = qos_yaml;
            }
            if known.type_hash.is_empty() {
                known.type_hash = type_hash;
            }
        } else {
            let type_name = canonical_type_name(&listed.type_name)
                .map_err(|_| BagError::SchemaName {
                    path: path.to_owned(),
                    topic: listed.name.clone(),
                    name: listed.type_name.clone(),
                })?
                .into();
            let schema = Arc::new(Schema {
                encoding: "".into(),
                text: String::new(),
            });
            topics.insert(
                Arc::clone(&name),
                TopicInfo {
                    name,
                    type_name,
                    schema,
                    qos_yaml,
                    type_hash,
                    message_count: 0,
                },
            );
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
