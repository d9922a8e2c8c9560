//! The box within which the end effector must stay.

use std::time::{Duration, Instant};

use thiserror::Error;

use super::{Hold, Refusal};

/// Three numbers along the axes of the robot's base.
type Axes = [f64; 3];

/// Why a measured pose is dropped.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum PoseError {
    /// An invalid pose.
    #[error("ee_pose: {0}")]
    Numbers(#[from] wm_wire::frames::pose::PoseError),
    /// A malformed stamp.
    #[error(transparent)]
    Stamp(#[from] Refusal),
    /// A position in another frame.
    #[error("the frame of ee_pose is {actual:?}; expected base_frame, {expected:?}")]
    Frame {
        /// The parameter.
        expected: String,
        /// What came.
        actual: String,
    },
}

impl PoseError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Stamp(_) => "bad_stamp",
            Self::Numbers(_) | Self::Frame { .. } => "pose",
        }
    }
}

/// A measured position of the end effector.
#[derive(Clone, Copy, Debug)]
struct Measurement {
    /// \[m\]
    position: Axes,
    /// Time of reception.
    at: Instant,
    /// Age then, by its stamp.
    age: Duration,
}

/// The box within which the end effector must stay, and its position.
#[derive(Clone, Debug)]
pub struct Workspace {
    least: Axes,
    most: Axes,
    lookahead: Duration,
    timeout: Duration,
    measured: Option<Measurement>,
}

impl Workspace {
    /// A box from `least` to `most` \[m\] that no motion may leave within `lookahead` of a position that is at most
    /// `timeout` old.
    pub fn new(least: [f64; 3], most: [f64; 3], lookahead: Duration, timeout: Duration) -> Self {
        Self {
            least,
            most,
            lookahead,
            timeout,
            measured: None,
        }
    }

    /// The lower and the upper corner \[m\].
    pub fn corners(&self) -> ([f64; 3], [f64; 3]) {
        (self.least, self.most)
    }

    /// Takes a position of the end effector, finite numbers \[m\], that was received at `at` and was of this `age` then.
    pub fn measure(&mut self, position: [f64; 3], at: Instant, age: Duration) {
        self.measured = Some(Measurement { position, at, age });
    }

    /// The position of the end effector, and its age.
    fn position(&self, now: Instant) -> Result<(Axes, Duration), Hold> {
        let Measurement { position, at, age } = self.measured.ok_or(Hold::NoPose)?;
        let timeout_s = self.timeout.as_secs_f64();
        let silent = now.saturating_duration_since(at);
        if silent > self.timeout {
            return Err(Hold::PoseSilent { timeout_s });
        }
        let age = silent.saturating_add(age);
        if age > self.timeout {
            return Err(Hold::PoseOld { timeout_s });
        }
        Ok((position, age))
    }

    /// Checks that the position of the end effector is known.
    ///
    /// # Errors
    /// [`Hold`] says why the arm may not move.
    pub fn check(&self, now: Instant) -> Result<(), Hold> {
        self.position(now).map(drop)
    }

    /// A linear velocity \[m/s\], reduced so that the end effector does not leave the box, or not further, and the axes along
    /// which it was reduced. The nearer the side, the slower: the arm can stop in time.
    ///
    /// # Errors
    /// [`Hold`] says why the arm may not move.
    pub fn cut(&self, linear: [f64; 3], now: Instant) -> Result<([f64; 3], [bool; 3]), Hold> {
        let (position, age) = self.position(now)?;
        // Since it was measured the arm has moved on.
        let reach_s = (self.lookahead + age).as_secs_f64().max(1e-3);
        let mut left = [0.0; 3];
        let mut is_cut = [false; 3];
        let sides = self.least.into_iter().zip(self.most);
        let axes = linear.into_iter().zip(position).zip(sides);
        for ((slot, is_cut), ((velocity, at), (least, most))) in
            left.iter_mut().zip(&mut is_cut).zip(axes)
        {
            let down = ((least - at) / reach_s).min(0.0);
            let up = ((most - at) / reach_s).max(0.0);
            *slot = velocity.clamp(down, up);
            *is_cut = *slot != velocity;
        }
        Ok((left, is_cut))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_a_side_only_the_motion_towards_it_is_cut() {
        let now = Instant::now();
        let second = Duration::from_secs(1);
        let mut workspace = Workspace::new([0.0; 3], [1.0; 3], second, second);
        assert_eq!(workspace.cut([1.0; 3], now), Err(Hold::NoPose));
        // Inside near the upper side, at a side, and outside.
        workspace.measure([0.9, 0.0, 1.5], now, Duration::ZERO);
        let (left, is_cut) = workspace.cut([0.5, -0.5, 0.5], now).unwrap();
        assert!((left[0] - 0.1).abs() < 1e-12, "{left:?}");
        assert_eq!((left[1], left[2]), (0.0, 0.0));
        assert_eq!(is_cut, [true; 3]);
        let (left, is_cut) = workspace.cut([-0.5, 0.5, -0.5], now).unwrap();
        assert_eq!((left, is_cut), ([-0.5, 0.5, -0.5], [false; 3]));
        // An older position leaves less room.
        let (left, _) = workspace.cut([0.5, 0.0, 0.0], now + second).unwrap();
        assert!((left[0] - 0.05).abs() < 1e-12, "{left:?}");
        let held = workspace.cut([0.5; 3], now + 2 * second);
        assert_eq!(held, Err(Hold::PoseSilent { timeout_s: 1.0 }));
        // By its stamp, it is older than by its reception.
        workspace.measure([0.9, 0.0, 0.0], now, second / 2);
        let (left, _) = workspace.cut([0.5, 0.0, 0.0], now + second / 2).unwrap();
        assert!((left[0] - 0.05).abs() < 1e-12, "{left:?}");
        let held = workspace.check(now + second);
        assert_eq!(held, Err(Hold::PoseOld { timeout_s: 1.0 }));
    }
}
