//! The selection of topics, and the QoS of their subscriptions.

use wm_bag::TopicFilter;
use wm_ros::{Durability, Qos, Reliability, TopicInfo};

/// Queue length of a subscription. A camera's messages take about 200 KB each.
const DEPTH: usize = 64;

/// The topics to record.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Selection by name. If it is empty and `types` too, all topics that are not hidden.
    pub topics: TopicFilter,
    /// Types whose topics are recorded as well, as `package/msg/Type`.
    pub types: Vec<String>,
    /// Types whose topics are not recorded.
    pub exclude_types: Vec<String>,
}

impl Selection {
    /// Whether this topic is selected, and has a publisher.
    #[must_use]
    pub fn wants(&self, topic: &TopicInfo) -> bool {
        let filter = &self.topics;
        let is_named = filter.named().contains(&topic.name);
        // A hidden topic has a part that begins with an underscore. It is recorded only by its name.
        let is_hidden = topic.name.split('/').any(|part| part.starts_with('_'));
        let is_of_type = self.types.contains(&topic.type_name) && !filter.excludes(&topic.name);
        let is_all = self.types.is_empty() || !filter.is_all();
        ((is_all && filter.wants(&topic.name)) || is_of_type)
            && (is_named || !is_hidden)
            && !self.exclude_types.contains(&topic.type_name)
            && !topic.publishers.is_empty()
    }
}

/// The strongest QoS that all publishers of a topic offer, so that a subscription matches each of them.
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
        let of = |names: &[&str], exclude: &[&str]| {
            let owned = |names: &[&str]| names.iter().map(ToString::to_string).collect();
            TopicFilter::new(owned(names), None, owned(exclude), None).unwrap()
        };
        let named = Selection {
            topics: of(&["/a/_hidden"], &[]),
            ..Selection::default()
        };
        assert!(named.wants(&topic("/a/_hidden", vec![Qos::reliable(1)])));
        assert!(!named.wants(&topic("/b", vec![Qos::reliable(1)])));
        let without = Selection {
            topics: of(&[], &["/b"]),
            ..Selection::default()
        };
        assert!(!without.wants(&topic("/b", vec![Qos::reliable(1)])));
        assert!(without.wants(&topic("/c", vec![Qos::reliable(1)])));
    }

    #[test]
    fn types_add_to_names_or_take_away() {
        let text = "std_msgs/msg/String".to_owned();
        let other = TopicInfo {
            type_name: "std_msgs/msg/Bool".to_owned(),
            ..topic("/b", vec![Qos::reliable(1)])
        };
        let selected = |topics: TopicFilter, types: &[String], exclude_types: &[String]| {
            let selection = Selection {
                topics,
                types: types.to_vec(),
                exclude_types: exclude_types.to_vec(),
            };
            [
                selection.wants(&topic("/a", vec![Qos::reliable(1)])),
                selection.wants(&other),
            ]
        };
        let all = TopicFilter::default;
        let types = std::slice::from_ref(&text);
        assert_eq!(selected(all(), types, &[]), [true, false]);
        assert_eq!(selected(all(), &[], types), [false, true]);
        let of_b = TopicFilter::new(vec!["/b".into()], None, vec![], None).unwrap();
        assert_eq!(selected(of_b, types, &[]), [true, true]);
        let without_a = TopicFilter::new(vec![], None, vec!["/a".into()], None).unwrap();
        assert_eq!(selected(without_a, types, &[]), [false, false]);
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
