use serde::{Deserialize, Serialize};
use serde_yaml_ng::Value;

use crate::BagError;

/// Whether samples may be lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reliability {
    /// Lost samples are sent again.
    Reliable,
    /// Samples are sent once.
    BestEffort,
}

/// Which samples a late subscriber receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Durability {
    /// Samples that are published after it joined.
    Volatile,
    /// The last samples too ("latched").
    TransientLocal,
}

/// The policies of a ROS QoS profile that the suite uses. Deadline, lifespan and liveliness are written as "not set" and
/// ignored when read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QosProfile {
    /// Whether samples may be lost.
    pub reliability: Reliability,
    /// Which samples a late subscriber receives.
    pub durability: Durability,
    /// Queue depth (`keep_last`) \[samples\]; 0 keeps all.
    pub depth: u32,
}

/// rosbag2's infinite duration: the maximum of `rmw_time_t`.
const INFINITE: YamlDuration = YamlDuration {
    sec: 9_223_372_036,
    nsec: 854_775_807,
};

impl QosProfile {
    /// Actions, goals, plans: reliable, volatile, depth 10.
    #[must_use]
    pub const fn reliable() -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            depth: 10,
        }
    }

    /// Cameras and latents, as `SensorDataQoS`: best effort, volatile, depth 5.
    #[must_use]
    pub const fn sensor_data() -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            depth: 5,
        }
    }

    /// Latched topics: reliable, transient local, depth 1.
    #[must_use]
    pub const fn latched() -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            depth: 1,
        }
    }

    /// The text of `offered_qos_profiles` with this profile, as rosbag2 writes it since metadata version 9.
    #[must_use]
    pub fn to_yaml(&self) -> String {
        // Cannot fail: a struct of strings and numbers always has a YAML form.
        serde_yaml_ng::to_string(&[YamlProfile::from(self)]).unwrap_or_default()
    }

    /// Parses `offered_qos_profiles`: policies by name, or by the numbers of `rmw/types.h` in older bags.
    ///
    /// # Errors
    /// The text is not a YAML list of profiles, or has an unknown policy.
    pub fn parse_yaml(yaml: &str) -> Result<Vec<Self>, BagError> {
        if yaml.trim().is_empty() {
            return Ok(Vec::new());
        }
        let profiles: Vec<ParsedProfile> =
            serde_yaml_ng::from_str(yaml).map_err(|error| BagError::Qos(error.to_string()))?;
        profiles.iter().map(ParsedProfile::profile).collect()
    }
}

#[derive(Serialize)]
struct YamlProfile {
    history: &'static str,
    depth: u32,
    reliability: &'static str,
    durability: &'static str,
    deadline: YamlDuration,
    lifespan: YamlDuration,
    liveliness: &'static str,
    liveliness_lease_duration: YamlDuration,
    avoid_ros_namespace_conventions: bool,
}

#[derive(Clone, Copy, Serialize)]
struct YamlDuration {
    sec: u64,
    nsec: u64,
}

impl From<&QosProfile> for YamlProfile {
    fn from(profile: &QosProfile) -> Self {
        Self {
            history: if profile.depth == 0 {
                "keep_all"
            } else {
                "keep_last"
            },
            depth: profile.depth,
            reliability: match profile.reliability {
                Reliability::Reliable => "reliable",
                Reliability::BestEffort => "best_effort",
            },
            durability: match profile.durability {
                Durability::Volatile => "volatile",
                Durability::TransientLocal => "transient_local",
            },
            deadline: INFINITE,
            lifespan: INFINITE,
            liveliness: "automatic",
            liveliness_lease_duration: INFINITE,
            avoid_ros_namespace_conventions: false,
        }
    }
}

#[derive(Deserialize)]
struct ParsedProfile {
    history: Value,
    depth: u32,
    reliability: Value,
    durability: Value,
}

impl ParsedProfile {
    fn profile(&self) -> Result<QosProfile, BagError> {
        // With keep_last, middlewares write depth 0 for "default".
        let keep_all = policy(
            "history",
            &self.history,
            &[("keep_all", 2, true), ("keep_last", 1, false)],
            false,
        )?;
        Ok(QosProfile {
            reliability: policy(
                "reliability",
                &self.reliability,
                &[
                    ("reliable", 1, Reliability::Reliable),
                    ("best_effort", 2, Reliability::BestEffort),
                ],
                Reliability::Reliable,
            )?,
            durability: policy(
                "durability",
                &self.durability,
                &[
                    ("transient_local", 1, Durability::TransientLocal),
                    ("volatile", 2, Durability::Volatile),
                ],
                Durability::Volatile,
            )?,
            depth: if keep_all { 0 } else { self.depth.max(1) },
        })
    }
}

/// Parses a policy by name or number. `system_default` (0) and `unknown`, which recorders write for a publisher of another
/// vendor, give the default of ROS.
fn policy<T: Copy>(
    name: &str,
    value: &Value,
    known: &[(&str, u64, T)],
    default: T,
) -> Result<T, BagError> {
    let found = known
        .iter()
        .find(|(text, number, _)| value.as_str() == Some(text) || value.as_u64() == Some(*number))
        .map(|(_, _, found)| *found);
    let unset = value.as_u64() == Some(0)
        || value
            .as_str()
            .is_some_and(|text| ["system_default", "unknown", "best_available"].contains(&text))
        || value
            .as_u64()
            .is_some_and(|number| (3..=5).contains(&number));
    match found {
        Some(found) => Ok(found),
        None if unset => Ok(default),
        None => Err(BagError::Qos(format!("unknown {name} policy {value:?}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_survive_a_round_trip() {
        for profile in [
            QosProfile::reliable(),
            QosProfile::sensor_data(),
            QosProfile::latched(),
            QosProfile {
                depth: 0,
                ..QosProfile::reliable()
            },
        ] {
            assert_eq!(
                QosProfile::parse_yaml(&profile.to_yaml()).unwrap(),
                [profile]
            );
        }
    }

    #[test]
    fn numeric_policies_of_old_bags_are_read() {
        let yaml = "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline:\n    sec: 2147483647\n    nsec: 4294967295\n";
        let [profile] = QosProfile::parse_yaml(yaml).unwrap()[..] else {
            panic!("one profile")
        };
        assert_eq!(
            profile,
            QosProfile {
                depth: 1,
                ..QosProfile::reliable()
            }
        );
    }

    #[test]
    fn invalid_policies_are_named() {
        assert_eq!(QosProfile::parse_yaml("").unwrap(), []);
        let error = QosProfile::parse_yaml(
            "- {history: keep_last, depth: 1, reliability: maybe, durability: volatile}",
        )
        .unwrap_err()
        .to_string();
        assert!(
            error.contains("reliability") && error.contains("maybe"),
            "{error}"
        );
        assert!(QosProfile::parse_yaml("just text").is_err());
    }
}
