//! Displacements of each period, from poses.

use nalgebra::Isometry3;
use wm_wire::frames::pose::between;

use super::{Problem, period::Period, speeds::Speeds, stamp::JUMP_NS};
use crate::displacement::Displacement;

/// Number of poses in a row that confirm a leap.
const STAYS: u32 = 3;

/// The last pose of the end effector, and its pose at the beginning of the period.
#[derive(Clone, Debug)]
pub(super) struct Poses {
    what: &'static str,
    period_ns: i64,
    timeout_ns: i64,
    speeds: Speeds,
    state: Option<State>,
    /// The newest pose, if it leapt.
    leap: Option<Leap>,
}

#[derive(Clone, Copy, Debug)]
struct State {
    start_ns: i64,
    start: Isometry3<f64>,
    last_ns: i64,
    last: Isometry3<f64>,
}

/// A pose that leapt.
#[derive(Clone, Copy, Debug)]
struct Leap {
    stamp_ns: i64,
    pose: Isometry3<f64>,
    /// Poses in a row that agree with it, itself included.
    count: u32,
}

impl Poses {
    pub(super) fn new(what: &'static str, period_ns: i64, timeout_ns: i64, speeds: Speeds) -> Self {
        Self {
            what,
            period_ns,
            timeout_ns,
            speeds,
            state: None,
            leap: None,
        }
    }

    /// Stamp of the newest pose, a leap included.
    pub(super) fn newest_ns(&self) -> Option<i64> {
        let last_ns = self.state.map(|state| state.last_ns);
        last_ns.max(self.leap.map(|leap| leap.stamp_ns))
    }

    pub(super) fn clear(&mut self) {
        (self.state, self.leap) = (None, None);
    }

    /// Takes a pose; returns the periods that it completes, and how many are lost.
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
        let newest_ns = self
            .leap
            .map_or(state.last_ns, |leap| leap.stamp_ns.max(state.last_ns));
        let silent_ns = stamp_ns.saturating_sub(newest_ns);
        let seconds = |ns: i64| ns as f64 / 1e9;
        if silent_ns <= 0 {
            let (what, by_s) = (self.what, -seconds(silent_ns));
            if silent_ns > -JUMP_NS {
                return Err(Problem::Older {
                    what,
                    before_s: by_s,
                });
            }
            (self.state, self.leap) = (Some(begin), None);
            return Err(Problem::Jump { what, by_s });
        }
        let lost = stamp_ns.saturating_sub(state.start_ns) / self.period_ns;
        let periods = lost.unsigned_abs().max(1);
        if silent_ns > self.timeout_ns {
            (*state, self.leap) = (begin, None);
            return Err(Problem::Gap {
                what: self.what,
                periods,
                silent_s: seconds(silent_ns),
            });
        }
        let way = Displacement::between(&state.last, &pose);
        let share = self.speeds.share(&way, seconds(since_ns));
        // The longer ago the last good pose, the further the arm may be from it: a pose that stays is a leap all the same.
        let agreeing = self.leap.filter(|leap| {
            let way = Displacement::between(&leap.pose, &pose);
            let of_leap = self
                .speeds
                .share(&way, seconds(stamp_ns.saturating_sub(leap.stamp_ns)));
            of_leap <= 1.0 && of_leap < share
        });
        if share > 1.0 || agreeing.is_some() {
            let what = self.what;
            let count = agreeing.map_or(1, |leap| leap.count.saturating_add(1));
            if count >= STAYS {
                (*state, self.leap) = (begin, None);
                return Err(Problem::Moved { what, periods });
            }
            self.leap = Some(Leap {
                stamp_ns,
                pose,
                count,
            });
            return Err(self.speeds.leap(what, &way, seconds(since_ns)));
        }
        self.leap = None;
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
