//! A pause before endpoints are announced, while a participant of Fast DDS catches up with those that exist.
//!
//! A participant that has just been discovered asks for the announcements of all endpoints so far. rustdds sends a new one
//! at once, which then arrives before them, and without a timestamp, as all of rustdds 0.15.1's announcements. Fast DDS
//! sorts what it holds by timestamps alone (`ReaderHistory::add_change`), so these stay in the order of arrival; it looks
//! for one by its number, and gives up at a larger one of the same writer (`History::get_change_nts`). So it never looks at
//! the earlier announcements, and acknowledges them all the same: its nodes never hear of these endpoints. Here nothing is
//! announced until it has what there is.

use std::{
    sync::Mutex,
    time::{Duration, Instant},
};

use crate::{backend::EndpointId, dds::lock::lock};

/// eProsima's identifier (<https://www.omg.org/dds/vendor-ids/>), with which the identities of its participants begin.
const EPROSIMA: [u8; 2] = [0x01, 0x0f];
/// How long one takes to catch up: some 30 ms, and on a busy machine longer.
const CATCHING_UP: Duration = Duration::from_millis(250);
/// How long endpoints wait at most, where participants come one after the other.
const LONGEST: Duration = Duration::from_secs(1);

/// Since when, and until when, others catch up.
#[derive(Debug, Default)]
pub(in crate::dds) struct CatchUp {
    span: Mutex<Option<(Instant, Instant)>>,
}

impl CatchUp {
    /// A participant was discovered.
    pub(in crate::dds) fn discovered(&self, id: &EndpointId, now: Instant) {
        if !id.starts_with(&EPROSIMA) {
            return;
        }
        let mut span = lock(&self.span);
        let since = match *span {
            Some((since, until)) if now < until => since,
            _ => now,
        };
        *span = Some((since, (now + CATCHING_UP).min(since + LONGEST)));
    }

    /// How long to wait before the next endpoint is announced.
    fn remaining(&self, now: Instant) -> Duration {
        let span = *lock(&self.span);
        span.map_or(Duration::ZERO, |(_, until)| {
            until.saturating_duration_since(now)
        })
    }

    /// Whether endpoints have to wait.
    pub(in crate::dds) fn is_pending(&self) -> bool {
        !self.remaining(Instant::now()).is_zero()
    }

    /// Holds the thread until an endpoint may be announced: endpoints are made while a node starts, and rarely after.
    pub(in crate::dds) fn wait(&self) {
        loop {
            let remaining = self.remaining(Instant::now());
            if remaining.is_zero() {
                return;
            }
            std::thread::sleep(remaining);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_vendor(vendor: u8) -> EndpointId {
        let mut id = [7; 16];
        (id[0], id[1]) = (1, vendor);
        id
    }

    #[test]
    fn endpoints_wait_for_a_participant_of_fast_dds_and_for_no_other() {
        let (catch_up, begin) = (CatchUp::default(), Instant::now());
        catch_up.discovered(&of_vendor(0x12), begin);
        assert_eq!(catch_up.remaining(begin), Duration::ZERO);
        catch_up.discovered(&of_vendor(0x0f), begin);
        assert_eq!(catch_up.remaining(begin), CATCHING_UP);
        assert_eq!(catch_up.remaining(begin + CATCHING_UP), Duration::ZERO);
    }

    #[test]
    fn many_that_come_one_after_the_other_hold_nobody_up_for_long() {
        let (catch_up, begin) = (CatchUp::default(), Instant::now());
        let step = CATCHING_UP / 2;
        for number in 0..7 {
            let now = begin + step * number;
            catch_up.discovered(&of_vendor(0x0f), now);
            assert!(now + catch_up.remaining(now) <= begin + LONGEST);
        }
        assert_eq!(catch_up.remaining(begin + LONGEST), Duration::ZERO);
    }
}
