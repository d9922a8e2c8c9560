//! Displacements of each period, from velocities.

use super::{Problem, period::Period, stamp::JUMP_NS};
use crate::{displacement::Displacement, executor::Velocity};

/// The current velocity, and the displacement of the period before it.
#[derive(Clone, Debug)]
pub(super) struct Twists {
    period_ns: i64,
    /// How long a velocity holds.
    timeout_ns: i64,
    state: Option<State>,
}

#[derive(Clone, Copy, Debug)]
struct State {
    start_ns: i64,
    /// Since the start.
    displacement: Displacement,
    /// The time up to which it is known.
    until_ns: i64,
    velocity: Velocity,
    /// Stamp of that velocity.
    told_ns: i64,
}

impl Twists {
    pub(super) fn new(period_ns: i64, timeout_ns: i64) -> Self {
        Self {
            period_ns,
            timeout_ns,
            state: None,
        }
    }

    /// Stamp of the last velocity.
    pub(super) fn last_ns(&self) -> Option<i64> {
        self.state.map(|state| state.told_ns)
    }

    pub(super) fn clear(&mut self) {
        self.state = None;
    }

    /// Takes a velocity; returns the periods that it completes.
    pub(super) fn take(
        &mut self,
        stamp_ns: i64,
        velocity: Velocity,
    ) -> Result<Vec<Period>, Problem> {
        let what = "twist";
        let since_ns = self
            .last_ns()
            .map(|told_ns| stamp_ns.saturating_sub(told_ns));
        if let Some(since_ns) = since_ns
            && since_ns < 0
        {
            let by_s = -(since_ns as f64) / 1e9;
            if since_ns > -JUMP_NS {
                return Err(Problem::Older {
                    what,
                    before_s: by_s,
                });
            }
            self.begin(stamp_ns, velocity);
            return Err(Problem::Jump { what, by_s });
        }
        let over = self.advance(stamp_ns);
        let Some(state) = &mut self.state else {
            self.begin(stamp_ns, velocity);
            return Ok(over);
        };
        (state.velocity, state.told_ns) = (velocity, stamp_ns);
        match state.until_ns.saturating_sub(stamp_ns) {
            // It completes no further period.
            late_ns if late_ns > 0 => Err(Problem::Late {
                what,
                late_s: late_ns as f64 / 1e9,
            }),
            _ => Ok(over),
        }
    }

    fn begin(&mut self, stamp_ns: i64, velocity: Velocity) {
        self.state = Some(State {
            start_ns: stamp_ns,
            displacement: Displacement::none(),
            until_ns: stamp_ns,
            velocity,
            told_ns: stamp_ns,
        });
    }

    /// Advances to a time before which no further messages are expected; returns the periods completed by then. Without
    /// messages the arm stands still, and after a period without messages its motion is unknown.
    pub(super) fn advance(&mut self, now_ns: i64) -> Vec<Period> {
        let mut over = Vec::new();
        while let Some(state) = &mut self.state {
            let end_ns = state.start_ns.saturating_add(self.period_ns);
            let silent_ns = state.told_ns.saturating_add(self.timeout_ns);
            let to_ns = now_ns.min(end_ns);
            if to_ns > state.until_ns {
                let moving_ns = to_ns.min(silent_ns).saturating_sub(state.until_ns).max(0);
                let next = Displacement::of_velocity(state.velocity, moving_ns as f64 / 1e9);
                state.displacement = state.displacement.then(next);
                state.until_ns = to_ns;
            }
            if now_ns < end_ns {
                break;
            }
            over.push(Period {
                start_ns: state.start_ns,
                displacement: state.displacement,
            });
            if state.start_ns >= silent_ns {
                self.state = None;
                break;
            }
            (state.start_ns, state.displacement) = (end_ns, Displacement::none());
        }
        over
    }
}
