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

/// What `from` becomes by a change of at most `most` on the way to `to`. Braking goes first: an axis along which the arm has
/// to stop does not wait for the others.
fn step(from: Axes, to: Axes, most: f64) -> Axes {
    let whole = plus(to, from, -1.0);
    if norm(whole) <= most {
        return to;
    }
    // From where each axis has lost all the speed that it has to lose, on.
    let mut braked = from;
    for (axis, to) in braked.iter_mut().zip(to) {
        *axis = match *axis >= 0.0 {
            true => to.clamp(0.0, *axis),
            false => to.clamp(*axis, 0.0),
        };
    }
    let brake = plus(braked, from, -1.0);
    let braking = norm(brake);
    if braking >= most {
        return plus(from, brake, most / braking);
    }
    let rest = plus(to, braked, -1.0);
    // Greatest share of the rest with |brake + share x rest| = most. Both have the same signs, so it is at least 0; and it
    // is below 1, since the whole is more than most.
    let (square, product) = (dot(rest, rest), dot(brake, rest));
    let root = (product * product + square * (most * most - braking * braking)).max(0.0);
    let share = (root.sqrt() - product) / square.max(f64::MIN_POSITIVE);
    plus(braked, rest, share.clamp(0.0, 1.0))
}

fn dot([ax, ay, az]: Axes, [bx, by, bz]: Axes) -> f64 {
    ax * bx + ay * by + az * bz
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

    #[test]
    fn braking_goes_first() {
        let of = |linear| Velocity {
            linear,
            ..Velocity::ZERO
        };
        let (from, to) = (of([0.2, -0.05, 0.0]), of([0.0, 0.4, 0.0]));
        let next = LIMITS.toward(from, to, 0.1);
        assert!(next.linear[0] < 0.11 && next.linear[1] < 0.0, "{next:?}");
        let later = LIMITS.toward(next, to, 0.15);
        assert_eq!(later.linear[0], 0.0);
        assert!(later.linear[1] > 0.05, "{later:?}");
    }
}
