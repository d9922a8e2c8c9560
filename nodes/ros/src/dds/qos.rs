//! QoS profiles as DDS policies, with the memory bounds that profiles lack.

use crate::{Durability, Qos, Reliability};
use rustdds::{QosPolicies, QosPolicyBuilder, policy};

/// Large messages that a reliable writer keeps for slow readers.
pub(crate) const RELIABLE_WINDOW: usize = 512;
/// No bound for reliable writers: at a bound, rustdds 0.15.1 would stop the writer for every new reader until its first
/// acknowledgement. [`super::workarounds::line`] bounds the memory.
const UNBOUNDED: usize = i32::MAX as usize;
/// Samples that rustdds keeps of a topic. A separate thread takes them at once.
const READER_CACHE: usize = 64;

pub(super) fn for_writer(qos: Qos) -> QosPolicies {
    let least = match qos.reliability {
        Reliability::BestEffort => 1,
        Reliability::Reliable => UNBOUNDED,
    };
    profile(qos, qos.depth.max(least))
}

pub(super) fn for_reader(qos: Qos) -> QosPolicies {
    profile(qos, READER_CACHE.max(qos.depth))
}

/// How long a writer whose window is full waits for room \[ms\]: too short to hold up a node.
const WAIT_FOR_ROOM_MS: i64 = 5;

fn profile(qos: Qos, max_samples: usize) -> QosPolicies {
    // larger depths mean "all"
    let int = |number: usize| i32::try_from(number).unwrap_or(i32::MAX);
    let max_samples = int(max_samples);
    QosPolicyBuilder::new()
        .reliability(match qos.reliability {
            Reliability::BestEffort => policy::Reliability::BestEffort,
            Reliability::Reliable => policy::Reliability::Reliable {
                max_blocking_time: rustdds::Duration::from_millis(WAIT_FOR_ROOM_MS),
            },
        })
        .durability(match qos.durability {
            Durability::Volatile => policy::Durability::Volatile,
            Durability::TransientLocal => policy::Durability::TransientLocal,
        })
        .history(policy::History::KeepLast {
            depth: int(qos.depth.max(1)),
        })
        .resource_limits(policy::ResourceLimits {
            max_samples,
            max_instances: max_samples,
            max_samples_per_instance: max_samples,
        })
        .build()
}

/// The QoS of a discovered endpoint. Discovery does not announce the history; the depth is then 10, ROS' default.
pub(super) fn from_dds(qos: &QosPolicies) -> Qos {
    let depth = match qos.history() {
        // a negative depth reads as the default
        Some(policy::History::KeepLast { depth }) => usize::try_from(depth).unwrap_or(10),
        _ => 10,
    };
    Qos {
        reliability: match qos.reliability() {
            Some(policy::Reliability::Reliable { .. }) => Reliability::Reliable,
            _ => Reliability::BestEffort,
        },
        durability: match qos.durability() {
            None | Some(policy::Durability::Volatile) => Durability::Volatile,
            Some(_) => Durability::TransientLocal,
        },
        depth,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_survive() {
        for qos in [Qos::sensor_data(), Qos::reliable(10), Qos::latched(1)] {
            assert_eq!(from_dds(&for_writer(qos)), qos);
        }
        let limits = |qos| for_writer(qos).resource_limits().unwrap().max_samples;
        assert_eq!(limits(Qos::best_effort(5)), 5);
        assert_eq!(limits(Qos::reliable(5)), i32::MAX);
    }
}
