//! The greatest speeds of the arm.

use super::Problem;
use crate::{displacement::Displacement, executor::Velocity};

/// Poses that are nearer to each other differ by the noise of the measurement \[m\].
const NOISE_M: f64 = 0.02;
/// The same for turns \[rad\].
const NOISE_RAD: f64 = 0.1;

/// The greatest speeds of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Speeds {
    /// Greatest speed of the end effector, above zero \[m/s\].
    pub linear: f64,
    /// Greatest speed of its turns, above zero \[rad/s\].
    pub angular: f64,
}

impl Speeds {
    /// A displacement by what the arm can do in `seconds`; above 1, the arm cannot do it.
    pub(super) fn share(&self, way: &Displacement, seconds: f64) -> f64 {
        let of_way = way.translation.norm() / (NOISE_M + self.linear * seconds);
        let of_turn = way.turn.angle() / (NOISE_RAD + self.angular * seconds);
        of_way.max(of_turn)
    }

    /// A displacement that the arm cannot do, as a problem.
    pub(super) fn leap(&self, what: &'static str, way: &Displacement, seconds: f64) -> Problem {
        Problem::Leap {
            what,
            way: way.translation.norm(),
            turn: way.turn.angle(),
            seconds,
            most_way: NOISE_M + self.linear * seconds,
            most_turn: NOISE_RAD + self.angular * seconds,
        }
    }

    /// Checks that the arm can be so fast.
    ///
    /// # Errors
    /// [`Problem::TooFast`].
    pub(super) fn check_velocity(&self, velocity: Velocity) -> Result<(), Problem> {
        let norm = |[x, y, z]: [f64; 3]| x.hypot(y).hypot(z);
        let (linear, angular) = (norm(velocity.linear), norm(velocity.angular));
        match linear <= self.linear && angular <= self.angular {
            true => Ok(()),
            false => Err(Problem::TooFast {
                linear,
                angular,
                most_linear: self.linear,
                most_angular: self.angular,
            }),
        }
    }
}
