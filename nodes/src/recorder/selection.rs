//! Which topics are recorded, and with which quality of service.

use wm_ros::{Durability, Qos, Reliability, TopicInfo};

/// Messages of a topic that may wait in its subscription. Those of a camera take about 200 KB each.
const DEPTH: usize = 64;

/// The topics to record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Names; empty: all that are not hidden.
    pub topics: Vec<String>,
    /// Names that are left out.
    pub exclude: Vec<String>,
}

impl Selection {
    /// Whether this topic is recorded now: wanted, and there is a publisher.
    #[must_use]
    pub fn wants(&self, topic: &TopicInfo) -> bool {
        let is_named = self.topics.contains(&topic.name);
        // a hidden topic has a part that begins with an underscore; it is recorded where it is named
        let is_hidden = topic.name.split('/').any(|part| part.starts_with('_'));
        let is_wanted = is_named || (self.topics.is_empty() && !is_hidden);
        is_wanted && !self.exclude.contains(&topic.name) && !topic.publishers.is_empty()
    }
}

/// The strongest quality of service that all publishers of a topic offer, so that a subscription matches each.
#[must_use]
pub fn common_qos(publishers: &[Qos]) -> Qos {
    let all_reliable = publishers
        .iter()
        .all(|qos| qos.reliability == Reliability::Reliable);
    let all_latched = publishers
        .iter()
        .all(|qos| qos.durability == Durability::TransientLocal);
    Qos {
        reliability: if all_reliable {
            Reliability::Reliable
        } else {
            Reliability::BestEffort
        },
        durability: if all_latched {
            Durability::TransientLocal
        } else {
            Durability::Volatile
        },
        depth: DEPTH,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topic(name: &str, publishers: Vec<Qos>) -> TopicInfo {
        TopicInfo {
            name: name.to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            publishers,
            subscribers: 0,
        }
    }

    #[test]
    fn all_means_what_is_published_and_not_hidden() {
        let all = Selection::default();
        assert!(all.wants(&topic("/a/b", vec![Qos::reliable(1)])));
        assert!(!all.wants(&topic("/a/b", vec![])));
        assert!(!all.wants(&topic("/a/_hidden/b", vec![Qos::reliable(1)])));
        let named = Selection {
            topics: vec!["/a/_hidden".into()],
            exclude: vec![],
        };
        assert!(named.wants(&topic("/a/_hidden", vec![Qos::reliable(1)])));
        assert!(!named.wants(&topic("/b", vec![Qos::reliable(1)])));
        let without = Selection {
            topics: vec![],
            exclude: vec!["/b".into()],
        };
        assert!(!without.wants(&topic("/b", vec![Qos::reliable(1)])));
    }

    #[test]
    fn one_weak_publisher_weakens_the_subscription() {
        assert_eq!(
            common_qos(&[Qos::latched(1)]),
            Qos {
                depth: DEPTH,
                ..Qos::latched(1)
            }
        );
        assert_eq!(
            common_qos(&[Qos::latched(1), Qos::reliable(5)]),
            Qos {
                depth: DEPTH,
                ..Qos::reliable(1)
            }
        );
        assert_eq!(
            common_qos(&[Qos::sensor_data(), Qos::reliable(5)]),
            Qos::best_effort(DEPTH)
        );
    }
}
