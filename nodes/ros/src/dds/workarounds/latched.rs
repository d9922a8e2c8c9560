//! One order for a latched topic's samples from several DDS writers of a publisher.
//!
//! A publisher that starts a new DDS writer ([`super::line`]) repeats its last samples for late readers. A late reader
//! may also be connected to the previous writer, which keeps older samples. So the samples of a publisher carry
//! increasing times that contain the number of the publisher. Readers of this suite drop repeated samples, and samples
//! older than one from a later writer.

use crate::{backend::EndpointId, dds::identity::Peer, dds::identity::participant_of};
use rustdds::Timestamp;
use std::collections::BTreeMap;

/// Low bits of a time that hold the publisher's number. The unit is 2^-32 s (DDSI-RTPS 2.5, 9.3.2.1), so the error is
/// less than a microsecond.
const BITS: u32 = 12;
const MASK: u64 = (1 << BITS) - 1;

pub(in crate::dds) struct Stamps {
    publisher: u64,
    last: u64,
}

impl Stamps {
    /// `publisher`: its first DDS writer.
    pub(in crate::dds) fn new(publisher: &EndpointId) -> Self {
        // the entity key (DDSI-RTPS 2.5, 9.3.1.2), which rustdds counts up
        let number = publisher.iter().skip(12).take(3);
        let number = number.fold(0, |number, byte| number << 8 | u64::from(*byte));
        let publisher = number & MASK;
        Self {
            publisher,
            last: publisher,
        }
    }

    /// The time of the next sample: `now`, or just after the last sample if the wall clock was set back.
    pub(in crate::dds) fn next(&mut self, now: Timestamp) -> Timestamp {
        let time = now.to_ticks() & !MASK | self.publisher;
        self.last = time.max(self.last + MASK + 1);
        Timestamp::from_ticks(self.last)
    }
}

/// Publishers that a reader remembers: more than a topic has. Other programs with rustdds have times without a number.
const MOST: usize = 256;

/// The latest sample of each publisher, and its DDS writer.
#[derive(Default)]
pub(in crate::dds) struct Latest(BTreeMap<(Peer, u64), (EndpointId, Timestamp)>);

impl Latest {
    /// Whether this sample is a repetition by another DDS writer of its publisher, or older than a sample from a later
    /// writer.
    pub(in crate::dds) fn supersedes(&mut self, writer: EndpointId, time: Timestamp) -> bool {
        let publisher = (participant_of(&writer), time.to_ticks() & MASK);
        if self.0.len() >= MOST && !self.0.contains_key(&publisher) {
            self.0.pop_first();
        }
        let (last, latest) = self.0.entry(publisher).or_insert((writer, time));
        if *last != writer && time <= *latest {
            return true;
        }
        (*last, *latest) = (writer, time);
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SECOND: u64 = 1 << 32;

    /// Of one participant.
    fn writer(key: u8) -> EndpointId {
        let mut id = [7; 16];
        (id[12], id[13], id[14]) = (0, 0, key);
        id
    }

    fn at(seconds: u64) -> Timestamp {
        Timestamp::from_ticks(seconds * SECOND)
    }

    #[test]
    fn times_increase_if_the_clock_is_set_back() {
        let mut stamps = Stamps::new(&writer(1));
        let times = [at(5), at(5), at(3), at(6)].map(|now| stamps.next(now));
        assert!(times.is_sorted_by(|a, b| a < b), "{times:?}");
        let error = times[3].to_ticks() - at(6).to_ticks();
        assert!(error < SECOND / 1_000_000);
    }

    #[test]
    fn sample_is_taken_from_one_writer_of_its_publisher() {
        let (mut stamps, mut latest) = (Stamps::new(&writer(1)), Latest::default());
        let times: Vec<_> = (1..6).map(|second| stamps.next(at(second))).collect();
        assert!(!latest.supersedes(writer(1), times[0]));
        assert!(!latest.supersedes(writer(1), times[1]));
        // the next writer repeats it
        assert!(latest.supersedes(writer(2), times[1]));
        assert!(!latest.supersedes(writer(2), times[3]));
        assert!(latest.supersedes(writer(1), times[2]), "an older one");
        assert!(latest.supersedes(writer(1), times[3]));
        assert!(!latest.supersedes(writer(2), times[4]));
    }

    #[test]
    fn publishers_of_a_participant_are_independent() {
        let [mut one, mut other] = [1, 9].map(|key| Stamps::new(&writer(key)));
        let mut latest = Latest::default();
        assert!(!latest.supersedes(writer(1), one.next(at(8))));
        assert!(!latest.supersedes(writer(9), other.next(at(2))));
        assert!(!latest.supersedes(writer(1), one.next(at(9))));
    }

    #[test]
    fn publishers_are_forgotten_only_for_new_ones() {
        let mut latest = Latest::default();
        let stamp = |number: u64, second: u64| Timestamp::from_ticks((second * SECOND) | number);
        for number in 0..MOST as u64 {
            assert!(!latest.supersedes(writer(1), stamp(number, 5)));
        }
        for second in 6..9 {
            assert!(!latest.supersedes(writer(1), stamp(0, second)));
        }
        assert!(latest.supersedes(writer(2), stamp(0, 8)));
        assert!(latest.supersedes(writer(2), stamp(1, 5)));
        assert!(!latest.supersedes(writer(1), stamp(MOST as u64, 5)));
        assert_eq!(latest.0.len(), MOST);
    }

    proptest! {
        /// Two writers of a publisher, whose samples arrive interleaved in any way.
        #[test]
        fn samples_arrive_in_order_and_once(order in prop::collection::vec(any::<bool>(), 40), copies in 0_usize..5) {
            let (mut stamps, mut latest) = (Stamps::new(&writer(1)), Latest::default());
            let times: Vec<_> = (0..20).map(|second| stamps.next(at(second))).collect();
            let mut lines = [
                times[..10].iter().map(|time| (writer(1), *time)).collect::<Vec<_>>(),
                times[10 - copies..].iter().map(|time| (writer(2), *time)).collect(),
            ];
            lines.iter_mut().for_each(|line| line.reverse());
            let mut taken = Vec::new();
            for first in order.into_iter().chain([false; 20]).chain([true; 20]) {
                if let Some((writer, time)) = lines[usize::from(first)].pop()
                    && !latest.supersedes(writer, time)
                {
                    taken.push(time);
                }
            }
            prop_assert!(taken.is_sorted_by(|a, b| a < b));
            prop_assert_eq!(&taken[taken.len() - 10..], &times[10..]);
        }
    }
}
