//! QoS profiles in the terms of DDS, with the bounds on memory that profiles do not have.

use crate::{Durability, Qos, Reliability};
use rustdds::{QosPolicies, QosPolicyBuilder, policy};

/// Large messages that a reliable writer keeps for readers that have not taken them.
pub(crate) const RELIABLE_WINDOW: usize = 512;
/// What rustdds 0.15.1 lets a reliable writer keep: no bound, since at a bound every new reader would stop the writer
/// until its first acknowledgement. [`super::workarounds::line`] bounds it.
const UNBOUNDED: usize = i32::MAX as usize;
/// Samples that the middleware keeps of a topic until they are taken, which happens at once on a separate thread.
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

fn profile(qos: Qos, max_samples: usize) -> QosPolicies {
    // depths beyond 2^31 mean "all" to anybody who writes them
    let int = |number: usize| i32::try_from(number).unwrap_or(i32::MAX);
    let max_samples = int(max_samples);
    QosPolicyBuilder::new()
        .reliability(qos.into())
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

/// What discovery says of an endpoint. History is not announced; the depth reads as 10 then, ROS' default.
pub(super) fn from_dds(qos: &QosPolicies) -> Qos {
    let depth = match qos.history() {
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
