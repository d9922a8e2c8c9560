//! Measured positions, commanded positions and limits of the joints.

use std::time::{Duration, Instant};

use thiserror::Error;
use wm_msgs::sensor_msgs::JointState;

use super::{Hold, Moment, Rates, Refusal, refusal::stamp_of};

/// Stamps that go back by less are of messages that overtook each other; by more, the clock was set \[ns\].
const JUMP_NS: i64 = 100_000_000;

/// Why measured joints are dropped.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum JointError {
    /// A position that is not finite.
    #[error("joint_states has {name} at {value}; expected a finite number")]
    NotFinite {
        /// The joint.
        name: String,
        /// What came.
        value: f64,
    },
    /// Older than the last position of a joint.
    #[error("joint_states has {name} {before_s:.3} s older than before")]
    Older {
        /// The joint.
        name: String,
        /// By how much \[s\].
        before_s: f64,
    },
    /// A malformed stamp.
    #[error(transparent)]
    Stamp(#[from] Refusal),
}

impl JointError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "joints",
            Self::Older { .. } => "joints_older",
            Self::Stamp(_) => "bad_stamp",
        }
    }
}

/// A measured position of a joint.
#[derive(Clone, Copy, Debug)]
struct Measurement {
    /// \[rad or m\]
    place: f64,
    /// Time of reception.
    at: Instant,
    /// Age then, by its stamp.
    age: Duration,
    /// Of the message; 0 if it has none \[ns\].
    stamp_ns: i64,
}

/// Measured positions, commanded positions and limits of the joints.
#[derive(Clone, Debug)]
pub struct Joints {
    names: Vec<String>,
    /// Least and greatest position of each, infinite without a limit \[rad or m\].
    limits: Vec<(f64, f64)>,
    lookahead: Duration,
    timeout: Duration,
    /// Greatest distance from the commanded positions \[rad or m\].
    most_apart: f64,
    /// In the order of the names; parts of the robot may publish separately.
    measured: Vec<Option<Measurement>>,
    /// Commanded positions at the end of the last command period.
    commanded: Option<Rates>,
}

impl Joints {
    /// Joints of these names, which stay within `limits` \[rad or m\] and stop there within `lookahead`. They are measured at
    /// least every `timeout`, and at most `most_apart` from the commanded positions.
    pub fn new(
        names: Vec<String>,
        limits: Vec<(f64, f64)>,
        lookahead: Duration,
        timeout: Duration,
        most_apart: f64,
    ) -> Self {
        let measured = vec![None; names.len()];
        Self {
            names,
            limits,
            lookahead,
            timeout,
            most_apart,
            measured,
            commanded: None,
        }
    }

    /// Their names, in the order of the axes.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Least and greatest positions, in the order of the axes.
    pub fn limits(&self) -> &[(f64, f64)] {
        &self.limits
    }

    /// Takes positions of some or all of them.
    ///
    /// # Errors
    /// [`JointError`]: the message is dropped, and the earlier positions stay until their timeout.
    pub fn measure(&mut self, joints: &JointState, received: Moment) -> Result<(), JointError> {
        let stamp_ns = stamp_of("joint_states", joints.header.stamp)?;
        let mut found = Vec::new();
        for (index, (name, known)) in self.names.iter().zip(&self.measured).enumerate() {
            let mut all = joints.name.iter().zip(&joints.position);
            let Some((_, place)) = all.find(|(other, _)| *other == name) else {
                continue;
            };
            if !place.is_finite() {
                return Err(JointError::NotFinite {
                    name: name.clone(),
                    value: *place,
                });
            }
            let before_ns = known.map_or(0, |known| known.stamp_ns.saturating_sub(stamp_ns));
            if stamp_ns != 0 && (1..JUMP_NS).contains(&before_ns) {
                return Err(JointError::Older {
                    name: name.clone(),
                    before_s: before_ns as f64 / 1e9,
                });
            }
            found.push((index, *place));
        }
        for (index, place) in found {
            if let Some(known) = self.measured.get_mut(index) {
                *known = Some(Measurement {
                    place,
                    at: received.at,
                    age: received.age_of(stamp_ns),
                    stamp_ns,
                });
            }
        }
        Ok(())
    }

    /// The measured positions, once all are known.
    fn measured(&self) -> Option<Rates> {
        let places = self.measured.iter().copied();
        let places: Option<Vec<f64>> = places.map(|known| Some(known?.place)).collect();
        places.map(Rates::of)
    }

    /// The commanded positions; before any command, the measured ones.
    pub fn places(&self) -> Option<Rates> {
        self.commanded.or_else(|| self.measured())
    }

    /// Checks that all are measured in time: the oldest position counts.
    ///
    /// # Errors
    /// [`Hold`] says why the arm may not move.
    pub fn check(&self, now: Instant) -> Result<(), Hold> {
        for (name, known) in self.names.iter().zip(&self.measured) {
            let Some(known) = known else {
                return Err(Hold::NoJoints { name: name.clone() });
            };
            let (name, timeout_s) = (name.clone(), self.timeout.as_secs_f64());
            let silent = now.saturating_duration_since(known.at);
            if silent > self.timeout {
                return Err(Hold::JointsSilent { name, timeout_s });
            }
            if silent.saturating_add(known.age) > self.timeout {
                return Err(Hold::JointsOld { name, timeout_s });
            }
        }
        Ok(())
    }

    /// Checks that they are near the commanded positions.
    ///
    /// # Errors
    /// [`Hold::Apart`]: the arm does not follow.
    pub fn check_following(&self) -> Result<(), Hold> {
        let (Some(commanded), Some(measured)) = (self.commanded, self.measured()) else {
            return Ok(());
        };
        let apart = commanded.as_slice().iter().zip(measured.as_slice());
        let mut apart = apart
            .map(|(commanded, measured)| (commanded - measured).abs())
            .enumerate();
        match apart.find(|(_, by)| *by > self.most_apart) {
            None => Ok(()),
            Some((axis, by)) => Err(Hold::Apart {
                axis,
                by,
                most: self.most_apart,
            }),
        }
    }

    /// Reduces velocities so that no joint goes (further) beyond its limits; whether anything was cut. The nearer the limit,
    /// the slower: the joint can stop in time.
    pub fn cut(&self, velocity: Rates) -> (Rates, bool) {
        let Some(places) = self.places() else {
            return (Rates::zero(self.names.len()), true);
        };
        let reach_s = self.lookahead.as_secs_f64().max(1e-3);
        let mut left = velocity;
        let mut is_cut = false;
        let joints = places.as_slice().iter().zip(&self.limits);
        for (slot, (place, (least, most))) in left.as_mut_slice().iter_mut().zip(joints) {
            let down = ((least - place) / reach_s).min(0.0);
            let up = ((most - place) / reach_s).max(0.0);
            let cut = slot.clamp(down, up);
            is_cut |= cut != *slot;
            *slot = cut;
        }
        (left, is_cut)
    }

    /// Commands a motion at `velocity` for `seconds`.
    pub fn go(&mut self, velocity: Rates, seconds: f64) {
        self.commanded = self.places().map(|places| places.plus(velocity, seconds));
    }

    /// They stand still: the measured positions count as the commanded ones from now on.
    pub fn settle(&mut self) {
        self.commanded = None;
    }
}

#[cfg(test)]
mod tests {
    use wm_msgs::builtin_interfaces::Time;

    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn joints() -> Joints {
        let limits = vec![(-1.0, 1.0), (f64::NEG_INFINITY, f64::INFINITY)];
        Joints::new(vec!["a".into(), "b".into()], limits, SECOND, SECOND, 0.1)
    }

    fn state(names: &[&str], position: &[f64]) -> JointState {
        JointState {
            name: names.iter().map(|name| (*name).to_owned()).collect(),
            position: position.to_vec(),
            ..JointState::default()
        }
    }

    #[test]
    fn parts_are_merged_by_name_and_the_oldest_counts() {
        let now = Instant::now();
        let half = SECOND / 2;
        let at = |at| Moment::real(at, 0);
        let mut joints = joints();
        let missing = |name: &str| Err(Hold::NoJoints { name: name.into() });
        assert_eq!(joints.check(now), missing("a"));
        joints.measure(&state(&["b"], &[5.0]), at(now)).unwrap();
        assert_eq!((joints.places(), joints.check(now)), (None, missing("a")));
        joints
            .measure(&state(&["c", "a"], &[0.0, 0.5]), at(now + half))
            .unwrap();
        assert_eq!(joints.places().unwrap().as_slice(), [0.5, 5.0]);
        assert_eq!(joints.check(now + SECOND), Ok(()));
        // The other part goes on, this one does not.
        joints
            .measure(&state(&["a"], &[0.6]), at(now + SECOND))
            .unwrap();
        let silent = joints.check(now + SECOND + half).unwrap_err();
        assert!(
            matches!(&silent, Hold::JointsSilent { name, .. } if name == "b"),
            "{silent}"
        );
        let bad = joints.measure(&state(&["a", "b"], &[0.1, f64::NAN]), at(now));
        assert!(bad.unwrap_err().to_string().contains("b at NaN"));
        assert_eq!(joints.places().unwrap().as_slice(), [0.6, 5.0]);
    }

    #[test]
    fn joints_of_an_old_stamp_are_old() {
        let now = Moment::real(Instant::now(), 100_000_000_000);
        let mut joints = joints();
        let mut check = |stamp_ns: i64, after: Duration| {
            let mut state = state(&["a", "b"], &[0.0, 0.0]);
            state.header.stamp = Time::from_nanos(stamp_ns);
            joints.measure(&state, now).unwrap();
            joints.check(now.at + after).map_err(|hold| hold.reason())
        };
        assert_eq!(check(99_500_000_000, SECOND / 2), Ok(()));
        assert_eq!(check(99_500_000_000, SECOND), Err("old_joints"));
        assert_eq!(check(98_900_000_000, Duration::ZERO), Err("old_joints"));
        // Of another clock, and without a stamp.
        assert_eq!(check(5_000_000_000, Duration::ZERO), Err("old_joints"));
        assert_eq!(check(0, SECOND), Ok(()));
        assert_eq!(check(0, 2 * SECOND), Err("no_joints"));
    }

    #[test]
    fn joints_that_were_overtaken_are_dropped() {
        let now = Moment::real(Instant::now(), 0);
        let mut joints = joints();
        let mut measure = |ms: i64, place| {
            let mut state = state(&["a", "b"], &[place, 0.0]);
            state.header.stamp = Time::from_nanos(5_000_000_000 + ms * 1_000_000);
            let taken = joints.measure(&state, now).map_err(|error| error.reason());
            (taken, joints.places().unwrap().as_slice()[0])
        };
        assert_eq!(measure(0, 0.1), (Ok(()), 0.1));
        assert_eq!(measure(-10, 0.2), (Err("joints_older"), 0.1));
        assert_eq!(measure(0, 0.3), (Ok(()), 0.3));
        // The clock was set.
        assert_eq!(measure(-1_000, 0.4), (Ok(()), 0.4));
    }

    #[test]
    fn near_a_limit_a_joint_slows_down_and_the_way_back_is_free() {
        let mut joints = joints();
        joints
            .measure(
                &state(&["a", "b"], &[0.9, 0.0]),
                Moment::real(Instant::now(), 0),
            )
            .unwrap();
        let (left, is_cut) = joints.cut(Rates::of([0.5, 0.5]));
        assert!(is_cut && (left.as_slice()[0] - 0.1).abs() < 1e-12);
        assert_eq!(left.as_slice()[1], 0.5);
        let (left, is_cut) = joints.cut(Rates::of([-0.5, -9.0]));
        assert_eq!((left.as_slice(), is_cut), (&[-0.5, -9.0][..], false));
    }

    #[test]
    fn an_arm_that_does_not_follow_is_noticed() {
        let mut joints = joints();
        joints
            .measure(
                &state(&["a", "b"], &[0.0, 0.0]),
                Moment::real(Instant::now(), 0),
            )
            .unwrap();
        joints.go(Rates::of([0.5, 0.0]), 0.1);
        assert_eq!(joints.check_following(), Ok(()));
        joints.go(Rates::of([0.5, 0.0]), 0.2);
        assert!(matches!(
            joints.check_following(),
            Err(Hold::Apart { axis: 0, .. })
        ));
        joints.settle();
        assert_eq!(joints.places().unwrap().as_slice(), [0.0, 0.0]);
    }
}
