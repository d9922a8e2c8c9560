//! Quality of service by topic, from a file in the form of `ros2 bag`'s `--qos-profile-overrides-path`.
//!
//! ```yaml
//! /camera/image_raw: {reliability: best_effort, depth: 5}
//! /map: {durability: transient_local, history: keep_all}
//! ```
//! The defaults are reliable, volatile, keep last 10. Deadline, lifespan and liveliness are read but not applied.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use thiserror::Error;
use wm_ros::{Durability, Qos, Reliability};

/// Depth that stands for "keep all": bounded all the same.
pub const KEEP_ALL_DEPTH: usize = 1000;

/// A file that cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum QosOverridesError {
    /// It cannot be read.
    #[error("QoS overrides {}: {reason}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// It is not a map of topics to profiles.
    #[error(
        "QoS overrides {}: {reason}; expected topics, each with any of reliability (reliable, best_effort), durability \
         (volatile, transient_local), history (keep_last, keep_all) and depth",
        path.display()
    )]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        reason: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Profile {
    reliability: Option<ReliabilityName>,
    durability: Option<DurabilityName>,
    history: Option<HistoryName>,
    depth: Option<usize>,
    #[serde(rename = "deadline")]
    _deadline: Option<serde_yaml_ng::Value>,
    #[serde(rename = "lifespan")]
    _lifespan: Option<serde_yaml_ng::Value>,
    #[serde(rename = "liveliness")]
    _liveliness: Option<serde_yaml_ng::Value>,
    #[serde(rename = "liveliness_lease_duration")]
    _lease: Option<serde_yaml_ng::Value>,
    #[serde(rename = "avoid_ros_namespace_conventions")]
    _conventions: Option<bool>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum ReliabilityName {
    Reliable,
    BestEffort,
    SystemDefault,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum DurabilityName {
    Volatile,
    TransientLocal,
    SystemDefault,
}

#[derive(Deserialize, PartialEq)]
#[serde(rename_all = "snake_case")]
enum HistoryName {
    KeepLast,
    KeepAll,
    SystemDefault,
}

impl From<Profile> for Qos {
    fn from(profile: Profile) -> Self {
        let keeps_all = profile.history == Some(HistoryName::KeepAll);
        Self {
            reliability: match profile.reliability {
                Some(ReliabilityName::BestEffort) => Reliability::BestEffort,
                _ => Reliability::Reliable,
            },
            durability: match profile.durability {
                Some(DurabilityName::TransientLocal) => Durability::TransientLocal,
                _ => Durability::Volatile,
            },
            depth: match profile.depth {
                _ if keeps_all => KEEP_ALL_DEPTH,
                // 0 is the middleware's way to say "default"
                None | Some(0) => 10,
                Some(depth) => depth.min(KEEP_ALL_DEPTH),
            },
        }
    }
}

/// The profiles of a file, by topic. No file, an empty path, has none.
///
/// # Errors
/// The file cannot be read, or is none of this form.
pub fn read(path: &Path) -> Result<BTreeMap<String, Qos>, QosOverridesError> {
    if path.as_os_str().is_empty() {
        return Ok(BTreeMap::new());
    }
    let text = std::fs::read_to_string(path).map_err(|reason| QosOverridesError::File {
        path: path.to_owned(),
        reason,
    })?;
    parse(&text).map_err(|reason| QosOverridesError::Content {
        path: path.to_owned(),
        reason: reason.to_string(),
    })
}

fn parse(text: &str) -> Result<BTreeMap<String, Qos>, serde_yaml_ng::Error> {
    let profiles: BTreeMap<String, Profile> = serde_yaml_ng::from_str(text)?;
    let topics = profiles.into_iter();
    Ok(topics
        .map(|(topic, profile)| (topic, profile.into()))
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_are_those_of_rosbag2() {
        let profiles = parse(
            "/a: {reliability: best_effort, depth: 5}\n/b: {}\n/c:\n  history: keep_all\n  \
             durability: transient_local\n  deadline: {sec: 1, nsec: 0}\n  liveliness: automatic\n",
        )
        .unwrap();
        let expected = [
            ("/a", Qos::best_effort(5)),
            ("/b", Qos::reliable(10)),
            ("/c", Qos::latched(KEEP_ALL_DEPTH)),
        ];
        assert_eq!(profiles, expected.map(|(t, q)| (t.to_owned(), q)).into());
    }

    #[test]
    fn what_is_unknown_is_named() {
        for (text, named) in [
            ("/a: {reliability: maybe}", "maybe"),
            ("/a: {depht: 1}", "depht"),
            ("- /a", "sequence"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        let error = read(Path::new("/no/such.yaml")).unwrap_err().to_string();
        assert!(error.contains("/no/such.yaml"), "{error}");
        assert_eq!(read(Path::new("")).unwrap(), BTreeMap::new());
    }
}
