//! What is to be executed, and when.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{Layout, Offer, Rates, Refusal, Veto};

/// Offers that may have yet to begin: more than come within the time that they may lie ahead.
const MOST_NEXT: usize = 128;

/// An offer that passed every check.
#[derive(Clone, Debug)]
struct Accepted {
    offer: Offer,
    received: Instant,
}

/// What an offer tells for one command period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Told {
    /// Mean velocity over the period.
    pub velocity: Rates,
    /// The gripper's opening at its beginning.
    pub gripper: Option<f64>,
}

/// What has happened in a schedule since the last command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// The next offer has begun.
    Begun,
    /// The offer was received too long ago.
    Stale,
    /// The offer is over.
    Over,
}

/// The offer that is executed, and those after it by when they begin. Where one begins, the one before it ends.
#[derive(Clone, Debug, Default)]
pub(super) struct Schedule {
    current: Option<Accepted>,
    next: VecDeque<Accepted>,
}

impl Schedule {
    /// Takes an offer, which replaces those that would begin later.
    ///
    /// # Errors
    /// [`Refusal::Full`] where too many have yet to begin.
    pub fn push(&mut self, offer: Offer, received: Instant) -> Result<(), Refusal> {
        self.next
            .retain(|other| other.offer.begin_ns < offer.begin_ns);
        if self.next.len() >= MOST_NEXT {
            return Err(Refusal::Full(MOST_NEXT));
        }
        self.next.push_back(Accepted { offer, received });
        Ok(())
    }

    /// When the newest offer was made \[ns\].
    pub fn newest_ns(&self) -> Option<i64> {
        let offers = self.next.iter().chain(&self.current);
        offers.map(|accepted| accepted.offer.made_ns).max()
    }

    /// What is executed.
    pub fn current(&self) -> Option<&Offer> {
        self.current.as_ref().map(|accepted| &accepted.offer)
    }

    /// Forgets everything; whether anything had begun.
    pub fn clear(&mut self) -> bool {
        self.next.clear();
        self.current.take().is_some()
    }

    /// Drops what `judge` vetoes: of what has begun, and of what has yet to begin.
    pub fn veto(&mut self, judge: impl Fn(&Offer) -> Option<Veto>) -> (Option<Veto>, Vec<Veto>) {
        let of_current = self.current().and_then(&judge);
        if of_current.is_some() {
            self.current = None;
        }
        let mut of_next = Vec::new();
        self.next.retain(|accepted| {
            let veto = judge(&accepted.offer);
            let is_good = veto.is_none();
            of_next.extend(veto);
            is_good
        });
        (of_current, of_next)
    }

    /// Goes on to a moment.
    pub fn advance(&mut self, now_ns: i64, now: Instant, max_age: Duration) -> Option<Change> {
        let mut begun = None;
        let begins = |next: &mut Accepted| next.offer.begin_ns <= now_ns;
        while let Some(next) = self.next.pop_front_if(begins) {
            begun = Some(next);
        }
        if begun.is_some() {
            self.current = begun;
            return Some(Change::Begun);
        }
        let current = self.current.as_ref()?;
        let change = if current.offer.end_ns() <= now_ns {
            Change::Over
        } else if now.saturating_duration_since(current.received) > max_age {
            Change::Stale
        } else {
            return None;
        };
        self.current = None;
        Some(change)
    }

    /// What is told for the time from `from_ns` on, for `span_ns`, at whose beginning joints are at `places`. An action is a
    /// motion over an interval: one that lies in that time in part counts in part.
    pub fn told(&self, from_ns: i64, span_ns: i64, layout: &Layout, places: Rates) -> Option<Told> {
        let mut places = places;
        let to_ns = from_ns.saturating_add(span_ns);
        let mut told: Option<Told> = None;
        let mut offers = self.current.iter().chain(&self.next).peekable();
        while let Some(Accepted { offer, .. }) = offers.next() {
            if offer.begin_ns >= to_ns {
                break;
            }
            let until_ns = offers.peek().map_or(i64::MAX, |next| next.offer.begin_ns);
            // The bounds keep the period above zero.
            let period_s = offer.period_ns as f64 / 1e9;
            let first = from_ns.saturating_sub(offer.begin_ns) / offer.period_ns.max(1);
            let first = usize::try_from(first).unwrap_or(0);
            for (index, values) in offer.actions.iter().enumerate().skip(first) {
                let start_ns = offer.start_ns(index).max(from_ns);
                let end_ns = offer.start_ns(index + 1).min(to_ns).min(until_ns);
                if start_ns >= to_ns.min(until_ns) {
                    break;
                }
                if end_ns <= start_ns {
                    continue;
                }
                let share = (end_ns - start_ns) as f64 / span_ns.max(1) as f64;
                // At least a nanosecond: an action that is over is left out above.
                let left_ns = offer.start_ns(index + 1).saturating_sub(start_ns).max(1);
                let left_s = left_ns as f64 / 1e9;
                let velocity = layout.rates(values, period_s, left_s, places.as_slice());
                places = places.plus(velocity, (end_ns - start_ns) as f64 / 1e9);
                let told = told.get_or_insert_with(|| Told {
                    velocity: Rates::zero(layout.axes()),
                    gripper: layout.gripper(values),
                });
                told.velocity = told.velocity.plus(velocity, share);
            }
        }
        told
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::Source;
    use wm_motion::actions::ActionSpace;

    const MS: i64 = 1_000_000;

    fn offer(stamp_ms: i64, period_ms: i64, forward: &[f32]) -> Offer {
        let action = |dx: &f32| vec![*dx, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        Offer {
            source: Source::Chunk,
            stamp_ns: stamp_ms * MS,
            made_ns: stamp_ms * MS,
            begin_ns: stamp_ms * MS,
            period_ns: period_ms * MS,
            frame_id: String::new(),
            epoch: None,
            actions: forward.iter().map(action).collect(),
        }
    }

    fn forward(schedule: &Schedule, from_ms: i64, span_ms: i64) -> Option<f64> {
        let layout = Layout::new(ActionSpace::bridge()).unwrap();
        let told = schedule.told(from_ms * MS, span_ms * MS, &layout, Rates::zero(0));
        told.map(|told| told.velocity.velocity().linear[0])
    }

    #[test]
    fn the_motion_of_a_command_period_is_what_the_actions_do_in_it() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        // 30 Hz: three actions in 100 ms, of which none may be left out.
        schedule
            .push(offer(0, 20, &[0.001, 0.003, 0.005, 0.007, 0.009]), now)
            .unwrap();
        schedule.advance(0, now, Duration::from_secs(1));
        let near = |found: Option<f64>, expected: f64| {
            assert!((found.unwrap() - expected).abs() < 1e-6, "{found:?}");
        };
        near(forward(&schedule, 0, 100), 0.25);
        near(forward(&schedule, 10, 20), 0.1);
        near(forward(&schedule, 90, 20), 0.225);
        assert_eq!(forward(&schedule, 100, 20), None);
    }

    #[test]
    fn a_newer_offer_takes_over_where_it_begins() {
        let now = Instant::now();
        let age = Duration::from_secs(1);
        let mut schedule = Schedule::default();
        schedule.push(offer(0, 200, &[0.02; 4]), now).unwrap();
        assert_eq!(schedule.advance(0, now, age), Some(Change::Begun));
        schedule.push(offer(300, 200, &[-0.02; 2]), now).unwrap();
        assert_eq!(schedule.advance(250 * MS, now, age), None);
        let half = forward(&schedule, 250, 100).unwrap();
        assert!(half.abs() < 1e-6, "{half}");
        assert_eq!(schedule.advance(300 * MS, now, age), Some(Change::Begun));
        assert_eq!(schedule.advance(700 * MS, now, age), Some(Change::Over));
        assert_eq!(schedule.advance(700 * MS, now, age), None);
    }

    #[test]
    fn offers_that_each_begin_later_begin_all_the_same() {
        let now = Instant::now();
        let age = Duration::from_secs(10);
        let mut schedule = Schedule::default();
        let mut begun = 0;
        for tick in 0..40 {
            // Ten times a second, each for a second later.
            let offer = offer(tick * 100 + 1000, 200, &[0.02; 2]);
            schedule.push(offer, now).unwrap();
            let change = schedule.advance(tick * 100 * MS, now, age);
            begun += i32::from(change == Some(Change::Begun));
        }
        assert_eq!(begun, 30);
        let at_most = (0..200).map(|index| offer(10_000 + index, 200, &[0.02]));
        let pushed = at_most.map(|offer| schedule.push(offer, now));
        assert!(pushed.last().unwrap().is_err());
    }

    #[test]
    fn an_offer_is_executed_only_for_so_long_after_it_came() {
        let now = Instant::now();
        let age = Duration::from_secs(1);
        let mut schedule = Schedule::default();
        schedule.push(offer(0, 1000, &[0.02; 4]), now).unwrap();
        schedule.advance(0, now, age);
        let later = now + Duration::from_millis(1001);
        // A simulated clock may stand still.
        assert_eq!(schedule.advance(0, later, age), Some(Change::Stale));
    }
}
