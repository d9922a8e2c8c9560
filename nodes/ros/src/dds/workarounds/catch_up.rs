//! A pause in announcing endpoints, while a Fast DDS participant catches up with the existing ones.
//!
//! A participant that was just discovered requests the announcements of all endpoints. If rustdds sends a new
//! announcement at once, it arrives earlier than those. rustdds 0.15.1 sends announcements without timestamps. Fast DDS
//! sorts by timestamps alone (`ReaderHistory::add_change`), so the order of arrival stays. It searches for an
//! announcement by number, and stops at a larger number of the same writer (`History::get_change_nts`). So it never
//! reads the earlier announcements, but acknowledges them: its nodes never discover these endpoints.

use std::{
    sync::Mutex,
    time::{Duration, Instant},
};

use crate::{backend::EndpointId, lock::lock};

/// eProsima's identifier (<https://www.omg.org/dds/vendor-ids/>), the first bytes of its participants' identities.
const EPROSIMA: [u8; 2] = [0x01, 0x0f];
/// Catching up takes about 30 ms, and longer on a busy machine.
const CATCHING_UP: Duration = Duration::from_millis(250);
/// The longest pause, if participants arrive one after the other.
const LONGEST: Duration = Duration::from_secs(1);

/// When the current pause began and when it ends.
#[derive(Debug, Default)]
pub(in crate::dds) struct CatchUp {
    span: Mutex<Option<(Instant, Instant)>>,
}

impl CatchUp {
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

    /// Blocks the thread until an endpoint may be announced. Nodes rarely make endpoints after their start.
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
    fn endpoints_wait_for_fast_dds_participants_only() {
        let (catch_up, begin) = (CatchUp::default(), Instant::now());
        catch_up.discovered(&of_vendor(0x12), begin);
        assert_eq!(catch_up.remaining(begin), Duration::ZERO);
        catch_up.discovered(&of_vendor(0x0f), begin);
        assert_eq!(catch_up.remaining(begin), CATCHING_UP);
        assert_eq!(catch_up.remaining(begin + CATCHING_UP), Duration::ZERO);
    }

    #[test]
    fn pause_is_bounded_if_many_participants_arrive() {
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
