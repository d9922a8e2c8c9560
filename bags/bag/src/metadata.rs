use std::{
    collections::BTreeMap,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use serde_yaml_ng::Value;

use crate::BagError;

pub(crate) const FILE_NAME: &str = "metadata.yaml";
/// The version that the writer writes (rosbag2 `bag_metadata.hpp`); older ones are read too.
const VERSION: u32 = 9;
/// Bags with thousands of topics and files have far smaller metadata.
const MAX_BYTES: u64 = 64 << 20;

/// The content of `metadata.yaml`: one key.
#[derive(Serialize, Deserialize)]
struct Document {
    rosbag2_bagfile_information: Metadata,
}

/// The metadata of a bag (rosbag2 `rosbag2_storage/yaml.hpp`). Keys that older versions lack have defaults.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Metadata {
    pub version: u32,
    pub storage_identifier: String,
    #[serde(default)]
    pub duration: Nanoseconds,
    #[serde(default)]
    pub starting_time: SinceEpoch,
    #[serde(default)]
    pub message_count: u64,
    #[serde(default)]
    pub topics_with_message_count: Vec<TopicWithMessageCount>,
    #[serde(default)]
    pub compression_format: String,
    #[serde(default)]
    pub compression_mode: String,
    pub relative_file_paths: Vec<PathBuf>,
    #[serde(default)]
    pub files: Vec<FileInformation>,
    #[serde(default)]
    pub custom_data: Option<BTreeMap<String, String>>,
    #[serde(default)]
    pub ros_distro: String,
}

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Nanoseconds {
    pub nanoseconds: i64,
}

#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub(crate) struct SinceEpoch {
    pub nanoseconds_since_epoch: i64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct TopicWithMessageCount {
    pub topic_metadata: TopicMetadata,
    pub message_count: u64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct TopicMetadata {
    pub name: String,
    #[serde(rename = "type")]
    pub type_name: String,
    pub serialization_format: String,
    /// A list of profiles since version 9; earlier, YAML within a string.
    #[serde(default)]
    pub offered_qos_profiles: Value,
    #[serde(default)]
    pub type_description_hash: String,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct FileInformation {
    pub path: PathBuf,
    pub starting_time: SinceEpoch,
    pub duration: Nanoseconds,
    pub message_count: u64,
}

impl Metadata {
    /// The metadata of a bag with these MCAP files.
    pub fn of_files(files: Vec<FileInformation>) -> Self {
        // Files without messages have no time; 0 if no file has one.
        let spans = files.iter().filter(|file| file.message_count > 0);
        let start = spans
            .clone()
            .map(|file| file.starting_time.nanoseconds_since_epoch)
            .min()
            .unwrap_or(0);
        let end = spans
            .map(|file| {
                let start = file.starting_time.nanoseconds_since_epoch;
                start.saturating_add(file.duration.nanoseconds)
            })
            .max()
            .unwrap_or(start);
        Self {
            version: VERSION,
            storage_identifier: "mcap".to_owned(),
            duration: Nanoseconds {
                nanoseconds: end.saturating_sub(start),
            },
            starting_time: SinceEpoch {
                nanoseconds_since_epoch: start,
            },
            message_count: files.iter().map(|file| file.message_count).sum(),
            topics_with_message_count: Vec::new(),
            compression_format: String::new(),
            compression_mode: String::new(),
            relative_file_paths: files.iter().map(|file| file.path.clone()).collect(),
            files,
            custom_data: None,
            ros_distro: String::new(),
        }
    }

    /// Reads the bag's metadata; `None` if the file is missing.
    pub fn read(dir: &Path) -> Result<Option<Self>, BagError> {
        let path = dir.join(FILE_NAME);
        let wrong = |reason: String| BagError::Metadata {
            path: path.clone(),
            reason,
        };
        let size = match fs::metadata(&path) {
            Ok(found) => found.len(),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(BagError::io(&path, error)),
        };
        if size > MAX_BYTES {
            return Err(wrong(format!(
                "expected at most {MAX_BYTES} bytes, got {size}"
            )));
        }
        let bytes = fs::read(&path).map_err(|error| BagError::io(&path, error))?;
        let text = String::from_utf8(bytes).map_err(|error| wrong(error.to_string()))?;
        let document: Document = serde_yaml_ng::from_str(&text)
            .map_err(|error| wrong(format!("not the metadata of a rosbag2 bag: {error}")))?;
        Ok(Some(document.rosbag2_bagfile_information))
    }

    /// Replaces the bag's metadata atomically: even after a power cut, a reader finds all of it or none.
    pub fn write(self, dir: &Path) -> Result<(), BagError> {
        let path = dir.join(FILE_NAME);
        let text = serde_yaml_ng::to_string(&Document {
            rosbag2_bagfile_information: self,
        })
        .map_err(|error| BagError::Metadata {
            path: path.clone(),
            reason: error.to_string(),
        })?;
        let unfinished = dir.join("metadata.yaml.tmp");
        let write = || {
            let mut file = fs::File::create(&unfinished)?;
            file.write_all(text.as_bytes())?;
            // Without this, a power cut after the rename may leave an empty metadata.yaml.
            file.sync_all()
        };
        write().map_err(|error| BagError::io(&unfinished, error))?;
        fs::rename(&unfinished, &path).map_err(|error| BagError::io(&path, error))?;
        sync_folder(dir)
    }
}

/// Waits until the file names in `dir` are on the disk.
pub(crate) fn sync_folder(dir: &Path) -> Result<(), BagError> {
    let synced = fs::File::open(dir).and_then(|folder| folder.sync_all());
    synced.map_err(|error| BagError::io(dir, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_survives_a_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let file = |number: u64, start: i64| FileInformation {
            path: format!("bag_{number}.mcap").into(),
            starting_time: SinceEpoch {
                nanoseconds_since_epoch: start,
            },
            duration: Nanoseconds { nanoseconds: 5 },
            message_count: 7 * number,
        };
        let start = 1_700_000_000_000_000_000;
        let mut written = Metadata::of_files(vec![file(0, 0), file(1, start), file(2, start + 10)]);
        assert_eq!(
            (
                written.starting_time.nanoseconds_since_epoch,
                written.duration.nanoseconds,
                written.message_count
            ),
            (start, 15, 21),
            "a file without messages has no time"
        );
        written.custom_data = Some(BTreeMap::from([("a".into(), "1".into())]));
        written.clone().write(dir.path()).unwrap();
        let read = Metadata::read(dir.path()).unwrap().unwrap();
        assert_eq!(format!("{written:?}"), format!("{read:?}"));
        assert_eq!(read.version, 9);
    }

    #[test]
    fn missing_metadata_is_no_error_and_other_yaml_is() {
        let dir = tempfile::tempdir().unwrap();
        assert!(Metadata::read(dir.path()).unwrap().is_none());
        fs::write(dir.path().join(FILE_NAME), "just: yaml\n").unwrap();
        let error = Metadata::read(dir.path()).unwrap_err().to_string();
        assert!(
            error.contains("metadata.yaml") && error.contains("rosbag2_bagfile_information"),
            "{error}"
        );
    }
}
