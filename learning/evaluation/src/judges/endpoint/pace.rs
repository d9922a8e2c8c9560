use std::{collections::VecDeque, time::Duration};

use super::Clock;

const MINUTE: Duration = Duration::from_secs(60);

/// Limits the rate of requests: waits until the last minute allows one more.
#[derive(Debug)]
pub(super) struct Pace {
    requests_per_minute: Option<u32>,
    tokens_per_minute: Option<u64>,
    /// Times of requests and their known tokens, oldest first.
    sent: VecDeque<(Duration, u64)>,
    /// Tokens of the largest answer, the estimate for the next.
    largest: u64,
}

impl Pace {
    pub(super) fn new(requests_per_minute: Option<u32>, tokens_per_minute: Option<u64>) -> Self {
        Self {
            requests_per_minute,
            tokens_per_minute,
            sent: VecDeque::new(),
            largest: 0,
        }
    }

    /// Waits until a request is allowed, and counts it.
    pub(super) fn wait(&mut self, clock: &dyn Clock) {
        loop {
            let now = clock.now();
            while let Some((at, _)) = self.sent.front() {
                if now.saturating_sub(*at) < MINUTE {
                    break;
                }
                self.sent.pop_front();
            }
            let oldest = self.sent.front().map(|(at, _)| *at);
            // After an idle minute any request is allowed, even one above the limit.
            let Some(oldest) = oldest.filter(|_| self.is_full()) else {
                self.sent.push_back((now, self.largest));
                return;
            };
            clock.sleep((oldest + MINUTE).saturating_sub(now));
        }
    }

    fn is_full(&self) -> bool {
        let tokens = self.sent.iter().map(|(_, tokens)| tokens).sum::<u64>();
        let needed = tokens.saturating_add(self.largest);
        self.requests_per_minute
            .is_some_and(|limit| self.sent.len() >= limit as usize)
            || self.tokens_per_minute.is_some_and(|limit| needed > limit)
    }

    /// Adds the tokens of the last request.
    pub(super) fn took(&mut self, tokens: u64) {
        // Bounded, so that a sum cannot overflow.
        let tokens = tokens.min(u64::from(u32::MAX));
        self.largest = self.largest.max(tokens);
        if let Some((_, last)) = self.sent.back_mut() {
            *last = tokens;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::judges::endpoint::clock::tests::FakeClock;

    fn sent_at(mut pace: Pace, tokens: &[u64]) -> Vec<u64> {
        let clock = FakeClock::default();
        let sent = tokens.iter().map(|tokens| {
            pace.wait(&clock);
            let now = clock.now().as_secs();
            pace.took(*tokens);
            clock.sleep(Duration::from_secs(1));
            now
        });
        sent.collect()
    }

    #[test]
    fn no_minute_has_more_requests_than_allowed() {
        assert_eq!(sent_at(Pace::new(None, None), &[9; 4]), [0, 1, 2, 3]);
        assert_eq!(
            sent_at(Pace::new(Some(2), None), &[9; 6]),
            [0, 1, 60, 61, 120, 121]
        );
    }

    #[test]
    fn no_minute_has_more_tokens_than_allowed() {
        assert_eq!(
            sent_at(Pace::new(None, Some(30)), &[10; 5]),
            [0, 1, 2, 60, 61]
        );
        // Each exceeds the limit alone, but must be sent.
        assert_eq!(sent_at(Pace::new(None, Some(30)), &[50; 3]), [0, 60, 120]);
    }
}
