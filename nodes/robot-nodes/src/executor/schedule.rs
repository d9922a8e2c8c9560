//! The schedule of accepted offers.

use std::{collections::VecDeque, time::Duration};

use super::{Layout, Moment, Offer, Rates, Refusal, Veto};

/// Most offers that begin later: more than arrive within `max_lead`.
const MOST_NEXT: usize = 128;

/// Share of an offer's span, and time \[ns\], by which the node's clock may be slower than real time until it ends.
const SLOWER: i64 = 4;
const SLOWER_NS: i64 = 100_000_000;

/// An offer that passed every check.
#[derive(Clone, Debug)]
struct Accepted {
    offer: Offer,
    received: Moment,
}

impl Accepted {
    /// The reason not to execute it, or to end it, at a moment.
    fn expect_fresh(&self, now: Moment, max_age: Duration) -> Result<(), Refusal> {
        let age = self.received.age(now);
        match age > max_age {
            true => Err(Refusal::Stale {
                age_s: age.as_secs_f64(),
                most_s: max_age.as_secs_f64(),
            }),
            false => Ok(()),
        }
    }

    fn expect_left(&self, now: Moment) -> Result<(), Refusal> {
        let ago_ns = now.stamp_ns.saturating_sub(self.offer.end_ns());
        match ago_ns >= 0 {
            true => Err(Refusal::Late {
                ago_s: ago_ns as f64 / 1e9,
            }),
            false => Ok(()),
        }
    }

    /// Whether it has ended by real time: its motions would take longer than their periods.
    fn is_outrun(&self, now: Moment) -> bool {
        let span_ns = self.offer.end_ns().saturating_sub(self.received.stamp_ns);
        let most_ns = span_ns
            .saturating_add(span_ns / SLOWER)
            .saturating_add(SLOWER_NS);
        let most = Duration::from_nanos(u64::try_from(most_ns).unwrap_or(0));
        now.at.saturating_duration_since(self.received.at) > most
    }
}

/// The motion of the offers in one command period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PeriodMotion {
    /// Mean velocity over the period.
    pub velocity: Rates,
    /// The gripper's opening at its beginning.
    pub gripper: Option<f64>,
    /// The share of the period that offers cover, if they end within it.
    pub running_out: Option<f64>,
}

/// A change of the schedule since the last command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// The next offer has begun.
    Begun,
    /// The offer was received too long ago.
    Stale,
    /// The offer has ended by real time, but not by the node's clock.
    Outrun,
    /// The offer has ended.
    Over {
        /// When it was \[ns\].
        end_ns: i64,
    },
}

/// The current offer, and later ones by their beginning. When one begins, the one before it ends.
#[derive(Clone, Debug, Default)]
pub(super) struct Schedule {
    current: Option<Accepted>,
    next: VecDeque<Accepted>,
}

impl Schedule {
    /// Takes an offer, which replaces those that would begin later.
    ///
    /// # Errors
    /// [`Refusal::Full`] if too many begin later.
    pub fn push(&mut self, offer: Offer, received: Moment) -> Result<(), Refusal> {
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

    /// The offer that is executed.
    pub fn current(&self) -> Option<&Offer> {
        self.current.as_ref().map(|accepted| &accepted.offer)
    }

    /// Whether there is no offer.
    pub fn is_empty(&self) -> bool {
        self.current.is_none() && self.next.is_empty()
    }

    /// Drops all offers; returns whether one had begun.
    pub fn clear(&mut self) -> bool {
        self.next.clear();
        self.current.take().is_some()
    }

    /// Drops offers that `judge` vetoes; returns the causes of the current one and of later ones.
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

    /// Drops plans of an older epoch; returns whether one had begun, and how many had not.
    pub fn drop_older(&mut self, epoch: u64) -> (bool, usize) {
        let is_older = |accepted: &Accepted| accepted.offer.epoch.is_some_and(|of| of < epoch);
        let before = self.next.len();
        self.next.retain(|accepted| !is_older(accepted));
        let dropped = before.saturating_sub(self.next.len());
        (
            self.current.take_if(|current| is_older(current)).is_some(),
            dropped,
        )
    }

    /// Advances to a command period of `span_ns` that begins now. Returns the change, and the reasons for offers that should
    /// begin by its end and do not.
    pub fn advance(
        &mut self,
        now: Moment,
        span_ns: i64,
        max_age: Duration,
    ) -> (Option<Change>, Vec<Refusal>) {
        let mut dropped = Vec::new();
        let until_ns = now.stamp_ns.saturating_add(span_ns);
        self.next.retain(|next| {
            if next.offer.begin_ns > now.stamp_ns && next.offer.begin_ns >= until_ns {
                return true;
            }
            let fresh = next
                .expect_fresh(now, max_age)
                .and_then(|()| next.expect_left(now));
            let is_fresh = fresh.is_ok();
            dropped.extend(fresh.err());
            is_fresh
        });
        let mut begun = None;
        let begins = |next: &mut Accepted| next.offer.begin_ns <= now.stamp_ns;
        while let Some(next) = self.next.pop_front_if(begins) {
            begun = Some(next);
        }
        if begun.is_none() && self.current.is_none() {
            // It begins within the period.
            begun = self
                .next
                .pop_front_if(|next| next.offer.begin_ns < until_ns);
        }
        if begun.is_some() {
            self.current = begun;
            return (Some(Change::Begun), dropped);
        }
        let change = self.current.as_ref().and_then(|current| {
            if current.expect_left(now).is_err() {
                Some(Change::Over {
                    end_ns: current.offer.end_ns(),
                })
            } else if current.expect_fresh(now, max_age).is_err() {
                Some(Change::Stale)
            } else {
                current.is_outrun(now).then_some(Change::Outrun)
            }
        });
        if change.is_some() {
            self.current = None;
        }
        (change, dropped)
    }

    /// The motion from `from_ns` on, for `span_ns`, with joints at `places` at its beginning. An action is a motion over an
    /// interval: its part within that time counts.
    pub fn motion(
        &self,
        from_ns: i64,
        span_ns: i64,
        layout: &Layout,
        places: Rates,
    ) -> Option<PeriodMotion> {
        let mut places = places;
        let to_ns = from_ns.saturating_add(span_ns);
        let mut motion: Option<PeriodMotion> = None;
        let mut offers = self.current.iter().chain(&self.next).peekable();
        let mut covered = 0.0;
        while let Some(Accepted { offer, .. }) = offers.next() {
            if offer.begin_ns >= to_ns {
                break;
            }
            let until_ns = offers.peek().map_or(i64::MAX, |next| next.offer.begin_ns);
            // The bounds keep the period above zero.
            let period_s = offer.period_ns as f64 / 1e9;
            let first = from_ns.saturating_sub(offer.begin_ns) / offer.period_ns.max(1);
            // Negative: the offer begins later, so its first action counts.
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
                // At least a nanosecond: an action that is over is skipped above.
                let left_ns = offer.start_ns(index + 1).saturating_sub(start_ns).max(1);
                let left_s = left_ns as f64 / 1e9;
                let velocity = layout.rates(values, period_s, left_s, places.as_slice());
                places = places.plus(velocity, (end_ns - start_ns) as f64 / 1e9);
                let motion = motion.get_or_insert_with(|| PeriodMotion {
                    velocity: Rates::zero(layout.axes()),
                    gripper: layout.gripper(values),
                    running_out: None,
                });
                motion.velocity = motion.velocity.plus(velocity, share);
                covered += share;
                motion.running_out = (end_ns < to_ns).then_some(covered);
            }
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    use crate::executor::Source;
    use wm_motion::actions::ActionSpace;

    const MS: i64 = 1_000_000;

    fn offer(stamp_ms: i64, period_ms: i64, forward: &[f32]) -> Offer {
        let action = |dx: &f32| vec![*dx, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        Offer {
            source: Source::Chunk,
            stamp_ns: stamp_ms * MS,
            made_ns: stamp_ms * MS,
            capture_ns: None,
            begin_ns: stamp_ms * MS,
            period_ns: period_ms * MS,
            frame_id: String::new(),
            epoch: None,
            actions: forward.iter().map(action).collect(),
        }
    }

    /// A moment at which both clocks say the same.
    fn at(begin: Instant, ms: i64) -> Moment {
        Moment::real(begin + Duration::from_millis(ms.unsigned_abs()), ms * MS)
    }

    fn advance(schedule: &mut Schedule, now: Moment, age_ms: u64) -> Option<Change> {
        let (change, dropped) = schedule.advance(now, 0, Duration::from_millis(age_ms));
        assert_eq!(dropped, []);
        change
    }

    fn forward(schedule: &Schedule, from_ms: i64, span_ms: i64) -> Option<f64> {
        let layout = Layout::new(ActionSpace::bridge()).unwrap();
        let motion = schedule.motion(from_ms * MS, span_ms * MS, &layout, Rates::zero(0));
        motion.map(|motion| motion.velocity.velocity().linear[0])
    }

    #[test]
    fn the_motion_of_a_command_period_is_what_the_actions_do_in_it() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        // 30 Hz: three actions in 100 ms, of which none may be left out.
        schedule
            .push(
                offer(0, 20, &[0.001, 0.003, 0.005, 0.007, 0.009]),
                at(now, 0),
            )
            .unwrap();
        advance(&mut schedule, at(now, 0), 1_000);
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
        let mut schedule = Schedule::default();
        let over = Change::Over { end_ns: 700 * MS };
        schedule
            .push(offer(0, 200, &[0.02; 4]), at(now, 0))
            .unwrap();
        let go = |schedule: &mut Schedule, ms| advance(schedule, at(now, ms), 1_000);
        assert_eq!(go(&mut schedule, 0), Some(Change::Begun));
        schedule
            .push(offer(300, 200, &[-0.02; 2]), at(now, 250))
            .unwrap();
        assert_eq!(go(&mut schedule, 250), None);
        let half = forward(&schedule, 250, 100).unwrap();
        assert!(half.abs() < 1e-6, "{half}");
        assert_eq!(go(&mut schedule, 300), Some(Change::Begun));
        assert_eq!(go(&mut schedule, 700), Some(over));
        assert_eq!(go(&mut schedule, 700), None);
    }

    #[test]
    fn offers_that_each_begin_later_begin_all_the_same() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        let mut begun = 0;
        for tick in 0..40 {
            // Ten times a second, each for a second later.
            let offer = offer(tick * 100 + 1000, 200, &[0.02; 2]);
            schedule.push(offer, at(now, tick * 100)).unwrap();
            let change = advance(&mut schedule, at(now, tick * 100), 10_000);
            begun += i32::from(change == Some(Change::Begun));
        }
        assert_eq!(begun, 30);
        let at_most = (0..200).map(|index| offer(10_000 + index, 200, &[0.02]));
        let pushed = at_most.map(|offer| schedule.push(offer, at(now, 0)));
        assert!(pushed.last().unwrap().is_err());
    }

    #[test]
    fn an_offer_is_executed_only_for_so_long_after_it_came() {
        let now = Instant::now();
        for (real_ms, stamp_ms) in [(1_001, 0), (0, 1_001)] {
            let mut schedule = Schedule::default();
            schedule
                .push(offer(0, 1000, &[0.02; 4]), at(now, 0))
                .unwrap();
            advance(&mut schedule, at(now, 0), 1_000);
            // Either clock may stand still.
            let later = Moment {
                stamp_ns: stamp_ms * MS,
                ..at(now, real_ms)
            };
            assert_eq!(advance(&mut schedule, later, 1_000), Some(Change::Stale));
        }
    }

    #[test]
    fn an_offer_that_begins_too_long_after_it_came_is_dropped() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        schedule
            .push(offer(1_500, 200, &[0.02; 4]), at(now, 0))
            .unwrap();
        let (change, dropped) = schedule.advance(at(now, 1_500), 0, Duration::from_secs(1));
        assert_eq!(change, None);
        assert!(
            matches!(dropped[..], [Refusal::Stale { .. }]),
            "{dropped:?}"
        );
        // The clock jumps past this one.
        schedule
            .push(offer(2_000, 200, &[0.02; 2]), at(now, 1_500))
            .unwrap();
        let (change, dropped) = schedule.advance(at(now, 2_400), 0, Duration::from_secs(1));
        assert_eq!(change, None);
        assert!(matches!(dropped[..], [Refusal::Late { .. }]), "{dropped:?}");
    }

    #[test]
    fn an_offer_ends_by_real_time_too() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        schedule
            .push(offer(0, 200, &[0.02; 4]), at(now, 0))
            .unwrap();
        advance(&mut schedule, at(now, 0), 10_000);
        let half_as_fast = |real_ms| Moment {
            stamp_ns: real_ms / 2 * MS,
            ..at(now, real_ms)
        };
        assert_eq!(advance(&mut schedule, half_as_fast(1_000), 10_000), None);
        let change = advance(&mut schedule, half_as_fast(1_200), 10_000);
        assert_eq!(change, Some(Change::Outrun));
    }

    #[test]
    fn plans_of_an_older_epoch_are_dropped() {
        let now = Instant::now();
        let mut schedule = Schedule::default();
        for (begin_ms, epoch) in [(0, 3), (400, 3), (800, 4)] {
            let plan = Offer {
                epoch: Some(epoch),
                ..offer(begin_ms, 200, &[0.02; 2])
            };
            schedule.push(plan, at(now, 0)).unwrap();
        }
        advance(&mut schedule, at(now, 0), 1_000);
        assert_eq!(schedule.drop_older(4), (true, 1));
        assert_eq!(schedule.drop_older(4), (false, 0));
    }
}
