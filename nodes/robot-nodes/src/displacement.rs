//! How the end effector is displaced, in the robot's base frame.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::executor::Velocity;

/// A displacement of the end effector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Displacement {
    /// In the base frame \[m\].
    pub(crate) translation: Vector3<f64>,
    /// About the axes of the base frame.
    pub(crate) turn: UnitQuaternion<f64>,
}

impl Displacement {
    /// Standing still.
    pub(crate) fn none() -> Self {
        Self {
            translation: Vector3::zeros(),
            turn: UnitQuaternion::identity(),
        }
    }

    /// The displacement by a velocity in `seconds`.
    pub(crate) fn of_velocity(velocity: Velocity, seconds: f64) -> Self {
        Self {
            translation: Vector3::from(velocity.linear) * seconds,
            turn: UnitQuaternion::from_scaled_axis(Vector3::from(velocity.angular) * seconds),
        }
    }

    /// The displacement from one pose to another.
    pub(crate) fn between(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Self {
        Self {
            translation: to.translation.vector - from.translation.vector,
            turn: to.rotation * from.rotation.inverse(),
        }
    }

    /// This one, and then `next`.
    pub(crate) fn then(self, next: Self) -> Self {
        Self {
            translation: self.translation + next.translation,
            turn: next.turn * self.turn,
        }
    }

    /// Roll, pitch and yaw of the turn \[rad\].
    pub(crate) fn rotation(&self) -> Vector3<f64> {
        let (roll, pitch, yaw) = self.turn.euler_angles();
        Vector3::new(roll, pitch, yaw)
    }

    /// The velocity of this displacement in `seconds`: the inverse of [`Self::of_velocity`].
    pub(crate) fn velocity(&self, seconds: f64) -> Velocity {
        Velocity {
            linear: (self.translation / seconds).into(),
            angular: (self.turn.scaled_axis() / seconds).into(),
        }
    }
}
