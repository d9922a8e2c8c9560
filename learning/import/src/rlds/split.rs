use std::{fs, path::Path};

use serde::Deserialize;

use crate::ImportError;

/// The needed part of `dataset_info.json` of TensorFlow Datasets.
#[derive(Deserialize)]
struct DatasetInfo {
    #[serde(default)]
    splits: Vec<Split>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Split {
    name: String,
    /// Number of records of each file; as text, since protobuf writes 64-bit numbers so in JSON.
    #[serde(default)]
    shard_lengths: Vec<String>,
}

/// The number of records of a file, by the `dataset_info.json` next to it; `None` without one, or if it does not list the
/// file.
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
        .and_then(|name| parse_split_and_shard(name.to_str()?))
        .and_then(|(split_name, shard)| {
            let split = info.splits.iter().find(|split| split.name == split_name)?;
            split.shard_lengths.get(shard)?.parse().ok()
        }))
}

/// Parses split and number of a file `DATASET-SPLIT.tfrecord-00000-of-00001`.
fn parse_split_and_shard(file_name: &str) -> Option<(&str, usize)> {
    let (front, shard) = file_name.split_once(".tfrecord-")?;
    let (_, split) = front.rsplit_once('-')?;
    let (number, _) = shard.split_once("-of-")?;
    Some((split, number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_names_are_parsed() {
        assert_eq!(
            parse_split_and_shard("bridge_dataset-train.tfrecord-00003-of-01024"),
            Some(("train", 3))
        );
        assert_eq!(parse_split_and_shard("some.tfrecord"), None);
    }
}
