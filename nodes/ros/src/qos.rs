//! Quality of service, offered by publishers and requested by subscriptions.

use std::fmt;

/// Delivery guarantee.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Samples may be lost.
    BestEffort,
    /// Lost samples are sent again.
    Reliable,
}

/// The samples that a late subscriber gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// Only new samples.
    Volatile,
    /// The last `depth` samples as well ("latched").
    TransientLocal,
}

/// A quality-of-service profile: reliability, durability, and how many samples are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Delivery guarantee.
    pub reliability: Reliability,
    /// The samples that a late subscriber gets.
    pub durability: Durability,
    /// Publisher: samples kept for late subscribers. Subscription: samples that may wait to be read.
    pub depth: usize,
}

impl Qos {
    /// Sensor data, as in rclcpp: best effort, volatile, 5 samples.
    pub const fn sensor_data() -> Self {
        Self::best_effort(5)
    }

    /// Best effort, volatile, `depth` samples. As a subscription it matches every publisher.
    pub const fn best_effort(depth: usize) -> Self {
        Self {
            reliability: Reliability::BestEffort,
            durability: Durability::Volatile,
            depth,
        }
    }

    /// Reliable, volatile, `depth` samples.
    pub const fn reliable(depth: usize) -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::Volatile,
            depth,
        }
    }

    /// Reliable, and a late subscriber gets the last `depth` samples.
    pub const fn latched(depth: usize) -> Self {
        Self {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            depth,
        }
    }

    /// Whether a subscription that requests `self` matches a publisher that offers `offered`: a request may not exceed
    /// the offer.
    pub fn matches(&self, offered: &Self) -> bool {
        (self.reliability == Reliability::BestEffort
            || offered.reliability == Reliability::Reliable)
            && (self.durability == Durability::Volatile
                || offered.durability == Durability::TransientLocal)
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reliability = match self.reliability {
            Reliability::BestEffort => "best effort",
            Reliability::Reliable => "reliable",
        };
        let durability = match self.durability {
            Durability::Volatile => "volatile",
            Durability::TransientLocal => "transient local",
        };
        write!(f, "{reliability}, {durability}, depth {}", self.depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_matches_what_offers_as_much() {
        assert!(Qos::sensor_data().matches(&Qos::reliable(10)));
        assert!(Qos::sensor_data().matches(&Qos::latched(1)));
        assert!(!Qos::reliable(10).matches(&Qos::sensor_data()));
        assert!(!Qos::latched(1).matches(&Qos::reliable(10)));
    }
}
