//! Displacements by periods, of poses.

use nalgebra::Isometry3;
use wm_frames::pose::between;

use super::{Problem, step::Period};
use crate::displacement::Displacement;

/// Stamps that go back by less belong to messages that overtook each other; by more, the clock was set \[ns\].
pub(super) const JUMP_NS: i64 = 100_000_000;

/// Where the end effector was last, and where it was when the period began.
#[derive(Clone, Debug)]
pub(super) struct Poses {
    what: &'static str,
    period_ns: i64,
    timeout_ns: i64,
    state: Option<State>,
}

#[derive(Clone, Copy, Debug)]
struct State {
    start_ns: i64,
    start: Isometry3<f64>,
    last_ns: i64,
    last: Isometry3<f64>,
}

impl Poses {
    pub(super) fn new(what: &'static str, period_ns: i64, timeout_ns: i64) -> Self {
        Self {
            what,
            period_ns,
            timeout_ns,
            state: None,
        }
    }

    /// Stamp of the last pose.
    pub(super) fn last_ns(&self) -> Option<i64> {
        self.state.map(|state| state.last_ns)
    }

    pub(super) fn clear(&mut self) {
        self.state = None;
    }

    /// Takes a pose, and gives the periods that are over with it, and how many are lost.
    pub(super) fn take(
        &mut self,
        stamp_ns: i64,
        pose: Isometry3<f64>,
    ) -> Result<Vec<Period>, Problem> {
        let begin = State {
            start_ns: stamp_ns,
            start: pose,
            last_ns: stamp_ns,
            last: pose,
        };
        let Some(state) = &mut self.state else {
            self.state = Some(begin);
            return Ok(Vec::new());
        };
        let since_ns = stamp_ns.saturating_sub(state.last_ns);
        let seconds = |ns: i64| ns as f64 / 1e9;
        if since_ns <= 0 {
            let (what, by_s) = (self.what, -seconds(since_ns));
            if since_ns > -JUMP_NS {
                return Err(Problem::Older {
                    what,
                    before_s: by_s,
                });
            }
            self.state = Some(begin);
            return Err(Problem::Jump { what, by_s });
        }
        if since_ns > self.timeout_ns {
            let lost = stamp_ns.saturating_sub(state.start_ns) / self.period_ns;
            *state = begin;
            return Err(Problem::Gap {
                what: self.what,
                periods: lost.unsigned_abs().max(1),
                silent_s: seconds(since_ns),
            });
        }
        let mut over = Vec::new();
        loop {
            let end_ns = state.start_ns.saturating_add(self.period_ns);
            if end_ns > stamp_ns {
                break;
            }
            // Between two poses the arm moves evenly; the last one is not after the end.
            let share = end_ns.saturating_sub(state.last_ns) as f64 / since_ns as f64;
            let end = between(&state.last, &pose, share);
            over.push(Period {
                start_ns: state.start_ns,
                displacement: Displacement::between(&state.start, &end),
            });
            (state.start_ns, state.start) = (end_ns, end);
        }
        (state.last_ns, state.last) = (stamp_ns, pose);
        Ok(over)
    }
}
