//! Where the joints are, where they are told to be, and where they may be.

use std::time::{Duration, Instant};

use thiserror::Error;
use wm_msgs::sensor_msgs::JointState;

use super::{Hold, Rates};

/// Why measured joints are left out.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum JointError {
    /// Not a number.
    #[error("joint_states has {name} at {value}, not a finite number")]
    NotFinite {
        /// The joint.
        name: String,
        /// What came.
        value: f64,
    },
}

impl JointError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        "joints"
    }
}

/// Where the joints are, where they are told to be, and where they may be.
#[derive(Clone, Debug)]
pub struct Joints {
    names: Vec<String>,
    /// Least and greatest position of each, infinite where there is no limit \[rad or m\].
    limits: Vec<(f64, f64)>,
    lookahead: Duration,
    timeout: Duration,
    /// How far they may be from where they are told to be \[rad or m\].
    most_apart: f64,
    measured: Option<(Rates, Instant)>,
    /// Where they are told to be at the end of the last command period.
    told: Option<Rates>,
}

impl Joints {
    /// Those with these names, which may be between `limits` \[rad or m\] and stop there within `lookahead`, whose
    /// positions come at least every `timeout`, and may be `most_apart` from where they are told to be.
    pub fn new(
        names: Vec<String>,
        limits: Vec<(f64, f64)>,
        lookahead: Duration,
        timeout: Duration,
        most_apart: f64,
    ) -> Self {
        Self {
            names,
            limits,
            lookahead,
            timeout,
            most_apart,
            measured: None,
            told: None,
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

    /// Takes where they are; that came at `at`. A message without all of them is of another part of the robot.
    ///
    /// # Errors
    /// [`JointError`]; what came before still counts, for as long as it may.
    pub fn measure(&mut self, joints: &JointState, at: Instant) -> Result<(), JointError> {
        let mut places = Rates::zero(self.names.len());
        for (place, name) in places.as_mut_slice().iter_mut().zip(&self.names) {
            let mut all = joints.name.iter().zip(&joints.position);
            let Some((_, value)) = all.find(|(other, _)| *other == name) else {
                return Ok(());
            };
            if !value.is_finite() {
                return Err(JointError::NotFinite {
                    name: name.clone(),
                    value: *value,
                });
            }
            *place = *value;
        }
        self.measured = Some((places, at));
        Ok(())
    }

    /// Where they are told to be; before anything was told, where they are.
    pub fn places(&self) -> Option<Rates> {
        self.told.or(self.measured.map(|(places, _)| places))
    }

    /// Whether it is known where they are.
    ///
    /// # Errors
    /// [`Hold`] says why the arm may not move.
    pub fn check(&self, now: Instant) -> Result<(), Hold> {
        let (_, at) = self.measured.ok_or(Hold::NoJoints)?;
        if now.saturating_duration_since(at) > self.timeout {
            return Err(Hold::JointsSilent {
                timeout_s: self.timeout.as_secs_f64(),
            });
        }
        Ok(())
    }

    /// Whether they are about where they are told to be.
    ///
    /// # Errors
    /// [`Hold::Apart`]: the arm does not follow.
    pub fn check_following(&self) -> Result<(), Hold> {
        let (Some(told), Some((measured, _))) = (self.told, self.measured) else {
            return Ok(());
        };
        let apart = told.as_slice().iter().zip(measured.as_slice());
        let mut apart = apart
            .map(|(told, measured)| (told - measured).abs())
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

    /// What is left of velocities so that no joint goes beyond its limits, or further, and whether anything was cut. The
    /// nearer the limit, the slower: the joint can stop in time.
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

    /// They are told to move at `velocity` for `seconds`.
    pub fn go(&mut self, velocity: Rates, seconds: f64) {
        self.told = self.places().map(|places| places.plus(velocity, seconds));
    }

    /// They stand still: where they are is where they are told to be from now on.
    pub fn settle(&mut self) {
        self.told = None;
    }
}

#[cfg(test)]
mod tests {
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
    fn they_are_found_by_name_and_only_together() {
        let now = Instant::now();
        let mut joints = joints();
        assert_eq!(joints.check(now), Err(Hold::NoJoints));
        joints.measure(&state(&["b"], &[5.0]), now).unwrap();
        assert_eq!(joints.places(), None);
        joints
            .measure(&state(&["b", "c", "a"], &[5.0, 0.0, 0.5]), now)
            .unwrap();
        assert_eq!(joints.places().unwrap().as_slice(), [0.5, 5.0]);
        let bad = joints.measure(&state(&["a", "b"], &[0.1, f64::NAN]), now);
        assert!(bad.unwrap_err().to_string().contains("b at NaN"));
        assert_eq!(joints.check(now + SECOND), Ok(()));
        assert!(matches!(
            joints.check(now + 2 * SECOND),
            Err(Hold::JointsSilent { .. })
        ));
    }

    #[test]
    fn near_a_limit_a_joint_slows_down_and_the_way_back_is_free() {
        let mut joints = joints();
        joints
            .measure(&state(&["a", "b"], &[0.9, 0.0]), Instant::now())
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
            .measure(&state(&["a", "b"], &[0.0, 0.0]), Instant::now())
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
