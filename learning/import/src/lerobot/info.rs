use std::{collections::BTreeMap, fs, path::Path};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::lerobot::LeRobotError;

pub(crate) const INFO: &str = "meta/info.json";
pub(crate) const ACTION: &str = "action";
pub(crate) const STATE: &str = "observation.state";
pub(crate) const SUCCESS: &str = "next.success";
pub(crate) const IMAGES: &str = "observation.images.";
pub(crate) const TIMESTAMP: &str = "timestamp";
pub(crate) const FRAME_INDEX: &str = "frame_index";
pub(crate) const EPISODE_INDEX: &str = "episode_index";
pub(crate) const INDEX: &str = "index";
pub(crate) const TASK_INDEX: &str = "task_index";
/// Our own column of `meta/episodes`: the stamp of the first frame in ns, which LeRobot lacks.
pub(crate) const START_STAMP: &str = "wm/start_stamp_ns";

/// The part of `meta/info.json` that is read and written.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Info {
    pub codebase_version: String,
    pub robot_type: Option<String>,
    #[serde(default)]
    pub total_episodes: u64,
    #[serde(default)]
    pub total_frames: u64,
    #[serde(default)]
    pub total_tasks: u64,
    #[serde(default = "chunks_size")]
    pub chunks_size: u64,
    #[serde(default)]
    pub data_files_size_in_mb: u64,
    #[serde(default)]
    pub video_files_size_in_mb: u64,
    /// Written as a whole number; v2.1 also allows a float.
    pub fps: f64,
    #[serde(default)]
    pub splits: BTreeMap<String, String>,
    pub data_path: String,
    pub video_path: Option<String>,
    pub features: BTreeMap<String, Feature>,
}

/// LeRobot's `DEFAULT_CHUNK_SIZE`.
pub(crate) const fn chunks_size() -> u64 {
    1000
}

/// The type of a column or video.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Feature {
    pub dtype: String,
    pub shape: Vec<u64>,
    #[serde(default)]
    pub names: Value,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub info: Option<Value>,
}

impl Feature {
    /// A column of numbers or booleans, with optional names.
    pub fn column(dtype: &str, width: usize, names: Option<&[String]>) -> Self {
        Self {
            dtype: dtype.to_owned(),
            shape: vec![width as u64],
            names: names.map_or(Value::Null, |names| names.into()),
            info: None,
        }
    }

    pub fn is_video(&self) -> bool {
        self.dtype == "video"
    }

    pub fn is_image(&self) -> bool {
        self.dtype == "image"
    }

    /// Number of values per row.
    pub fn width(&self) -> usize {
        let product = self.shape.iter().try_fold(1u64, |a, b| a.checked_mul(*b));
        // Saturates far above the greatest width that a data set may have.
        usize::try_from(product.unwrap_or(u64::MAX)).unwrap_or(usize::MAX)
    }

    /// The names of the values: a list, a nested list, or a list under one key (`{"motors": [...]}`); numbers if their count
    /// differs.
    pub fn value_names(&self) -> Vec<String> {
        let list = match &self.names {
            Value::Object(keys) => keys.values().next(),
            other => Some(other),
        };
        let list = list.and_then(Value::as_array);
        let list = list.map(|names| match names.as_slice() {
            [Value::Array(inner)] => inner,
            _ => names,
        });
        let names: Option<Vec<String>> = list.and_then(|names| {
            let texts = names.iter().map(|name| name.as_str().map(str::to_owned));
            texts.collect()
        });
        names
            .filter(|names| names.len() == self.width())
            .unwrap_or_else(|| (0..self.width()).map(|n| format!("value_{n}")).collect())
    }
}

impl Info {
    pub fn read(root: &Path) -> Result<Self, LeRobotError> {
        let path = root.join(INFO);
        let bytes = fs::read(&path).map_err(|source| LeRobotError::io(&path, source))?;
        let info: Self = serde_json::from_slice(&bytes)
            .map_err(|error| LeRobotError::corrupt(&path, error.to_string()))?;
        let bad = |reason: String| Err(LeRobotError::corrupt(&path, reason));
        if !(0.01..=10_000.0).contains(&info.fps) {
            return bad(format!("fps: expected 0.01 to 10000, got {}", info.fps));
        }
        if info.chunks_size == 0 {
            return bad("chunks_size: expected at least 1, got 0".to_owned());
        }
        /// Larger than the vectors of any robot.
        const MAX_WIDTH: usize = 1 << 16;
        for name in [ACTION, STATE] {
            if let Some(feature) = info.features.get(name)
                && !(1..=MAX_WIDTH).contains(&feature.width())
            {
                return bad(format!(
                    "features, {name}: expected a shape of 1 to {MAX_WIDTH} values, got {:?}",
                    feature.shape
                ));
            }
        }
        Ok(info)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_in_four_forms() {
        let feature = |names: Value| Feature {
            dtype: "float32".into(),
            shape: vec![2],
            names,
            info: None,
        };
        let named = ["a", "b"].map(str::to_owned);
        assert_eq!(feature(serde_json::json!(["a", "b"])).value_names(), named);
        assert_eq!(
            feature(serde_json::json!({"motors": ["a", "b"]})).value_names(),
            named
        );
        assert_eq!(
            feature(serde_json::json!([["a", "b"]])).value_names(),
            named
        );
        for unfit in [Value::Null, serde_json::json!(["a"]), serde_json::json!({})] {
            assert_eq!(feature(unfit).value_names(), ["value_0", "value_1"]);
        }
    }
}
