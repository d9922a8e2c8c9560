use std::{fs, path::Path};

use serde::Deserialize;

use crate::ImportError;

/// `dataset_info.json` of TensorFlow Datasets, as far as it is needed.
#[derive(Deserialize)]
struct DatasetInfo {
    #[serde(default)]
    splits: Vec<Split>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Split {
    name: String,
    /// Records of each file; numbers as text, as protobuf writes 64-bit numbers in JSON.
    #[serde(default)]
    shard_lengths: Vec<String>,
}

/// How many records a file should have, by the `dataset_info.json` beside it; none if there is none, or it does not
/// list this file.
pub(super) fn expected_records(shard: &Path) -> Result<Option<u64>, ImportError> {
    let info_file = shard.with_file_name("dataset_info.json");
    let text = match fs::read_to_string(&info_file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(ImportError::io(&info_file, error)),
    };
    let info: DatasetInfo = serde_json::from_str(&text).map_err(|error| {
        ImportError::corrupt(&info_file, format!("not a data set description: {error}"))
    })?;
    Ok(shard
        .file_name()
        .and_then(|name| split_and_shard(name.to_str()?))
        .and_then(|(split_name, shard)| {
            let split = info.splits.iter().find(|split| split.name == split_name)?;
            split.shard_lengths.get(shard)?.parse().ok()
        }))
}

/// Split and number of a file `DATASET-SPLIT.tfrecord-00000-of-00001`.
fn split_and_shard(file_name: &str) -> Option<(&str, usize)> {
    let (front, shard) = file_name.split_once(".tfrecord-")?;
    let (_, split) = front.rsplit_once('-')?;
    let (number, _) = shard.split_once("-of-")?;
    Some((split, number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_read() {
        assert_eq!(
            split_and_shard("bridge_dataset-train.tfrecord-00003-of-01024"),
            Some(("train", 3))
        );
        assert_eq!(split_and_shard("some.tfrecord"), None);
    }
}
