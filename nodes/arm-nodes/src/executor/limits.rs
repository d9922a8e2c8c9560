//! How fast the end effector may move, and how fast that may change.

use super::velocity::{Axes, Velocity, norm, plus};

/// Greatest magnitudes, all above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Of the linear velocity \[m/s\].
    pub linear_velocity: f64,
    /// Of the angular velocity \[rad/s\].
    pub angular_velocity: f64,
    /// Of the linear acceleration \[m/s^2\].
    pub linear_acceleration: f64,
    /// Of the angular acceleration \[rad/s^2\].
    pub angular_acceleration: f64,
}

impl Limits {
    /// The nearest velocity of the same direction that is within the limits.
    pub fn within(&self, velocity: Velocity) -> Velocity {
        Velocity {
            linear: at_most(velocity.linear, self.linear_velocity),
            angular: at_most(velocity.angular, self.angular_velocity),
        }
    }

    /// What `from` can become in `seconds` on the way to `target`; `target` itself where it can be reached.
    pub fn toward(&self, from: Velocity, target: Velocity, seconds: f64) -> Velocity {
        let (linear, angular) = (self.linear_acceleration, self.angular_acceleration);
        Velocity {
            linear: step(from.linear, target.linear, linear * seconds),
            angular: step(from.angular, target.angular, angular * seconds),
        }
    }

    /// Longest time from any velocity within the limits to zero \[s\].
    pub fn stopping_time(&self) -> f64 {
        let linear = self.linear_velocity / self.linear_acceleration;
        linear.max(self.angular_velocity / self.angular_acceleration)
    }
}

fn at_most(axes: Axes, most: f64) -> Axes {
    let magnitude = norm(axes);
    if magnitude <= most {
        return axes;
    }
    plus([0.0; 3], axes, most / magnitude)
}

fn step(from: Axes, to: Axes, most: f64) -> Axes {
    let change = plus(to, from, -1.0);
    let magnitude = norm(change);
    if magnitude <= most {
        return to;
    }
    plus(from, change, most / magnitude)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        linear_velocity: 0.5,
        angular_velocity: 1.0,
        linear_acceleration: 1.0,
        angular_acceleration: 10.0,
    };

    #[test]
    fn a_velocity_beyond_the_limit_keeps_its_direction() {
        let fast = Velocity {
            linear: [3.0, 0.0, -4.0],
            angular: [0.0, 0.5, 0.0],
        };
        let slowed = LIMITS.within(fast);
        assert!((slowed.linear[0] - 0.3).abs() < 1e-12);
        assert!((slowed.linear[2] + 0.4).abs() < 1e-12);
        assert_eq!(slowed.angular, fast.angular);
    }

    #[test]
    fn a_change_takes_its_time_and_arrives_exactly() {
        let target = Velocity {
            linear: [0.25, 0.0, 0.0],
            angular: [0.0, 0.0, 0.4],
        };
        let mut velocity = LIMITS.toward(Velocity::ZERO, target, 0.1);
        assert!((velocity.linear[0] - 0.1).abs() < 1e-12);
        assert_eq!(velocity.angular, target.angular);
        for _ in 0..2 {
            velocity = LIMITS.toward(velocity, target, 0.1);
        }
        assert_eq!(velocity, target);
        assert_eq!(LIMITS.stopping_time(), 0.5);
    }
}
