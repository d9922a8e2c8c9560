//! Limits of an arm's velocity and acceleration.

use super::{
    Rates,
    rates::{norm, plus},
};

/// Axes whose velocity has one magnitude: three of a translation, or a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// How many; at least one.
    pub axes: usize,
    /// Greatest magnitude of the velocity, above zero \[unit/s\].
    pub velocity: f64,
    /// Greatest magnitude of its change, above zero \[unit/s^2\].
    pub acceleration: f64,
}

/// Greatest magnitudes along all axes, group by group.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits(Vec<Group>);

impl Limits {
    /// The limits of the groups, in the order of their axes.
    pub fn new(groups: Vec<Group>) -> Self {
        Self(groups)
    }

    /// The limits of an end effector: (velocity \[m/s\], acceleration \[m/s^2\]) of its position, and (velocity \[rad/s\],
    /// acceleration \[rad/s^2\]) of its orientation.
    pub fn end_effector(linear: (f64, f64), angular: (f64, f64)) -> Self {
        let group = |(velocity, acceleration)| Group {
            axes: 3,
            velocity,
            acceleration,
        };
        Self(vec![group(linear), group(angular)])
    }

    /// The groups, in the order of their axes.
    pub fn groups(&self) -> &[Group] {
        &self.0
    }

    /// The nearest velocity of the same direction, in each group, that is within the limits.
    pub fn within(&self, velocity: Rates) -> Rates {
        self.by_group(velocity, velocity, |group, values, _| {
            let magnitude = norm(values);
            match magnitude <= group.velocity {
                true => Rates::of(values.iter().copied()),
                false => Rates::of(values.iter().map(|v| v * (group.velocity / magnitude))),
            }
        })
    }

    /// The velocity that can be reached from `from` in `seconds` on the way to `target`; `target` itself if it can be reached.
    pub fn toward(&self, from: Rates, target: Rates, seconds: f64) -> Rates {
        self.by_group(from, target, |group, from, to| {
            step(from, to, group.acceleration * seconds)
        })
    }

    /// Longest time from any velocity within the limits to zero \[s\].
    pub fn stopping_time(&self) -> f64 {
        let times = self
            .0
            .iter()
            .map(|group| group.velocity / group.acceleration);
        times.fold(0.0, f64::max)
    }

    fn by_group(
        &self,
        a: Rates,
        b: Rates,
        of_group: impl Fn(&Group, &[f64], &[f64]) -> Rates,
    ) -> Rates {
        let mut all = Rates::zero(0);
        let (mut a, mut b) = (a.as_slice(), b.as_slice());
        for group in &self.0 {
            let (Some((of_a, rest_a)), Some((of_b, rest_b))) = (
                a.split_at_checked(group.axes),
                b.split_at_checked(group.axes),
            ) else {
                break;
            };
            let values = of_group(group, of_a, of_b);
            all = Rates::of(all.as_slice().iter().chain(values.as_slice()).copied());
            (a, b) = (rest_a, rest_b);
        }
        all
    }
}

/// `from` changed by at most `most` on the way to `to`. Braking has priority: an axis along which the arm must stop does not
/// wait for the others.
fn step(from: &[f64], to: &[f64], most: f64) -> Rates {
    let whole = plus(to, from, -1.0);
    if norm(whole.as_slice()) <= most {
        return Rates::of(to.iter().copied());
    }
    // From where each axis has lost all the speed that it has to lose, on.
    let braked = from.iter().zip(to).map(|(from, to)| match *from >= 0.0 {
        true => to.clamp(0.0, *from),
        false => to.clamp(*from, 0.0),
    });
    let braked = Rates::of(braked);
    let brake = plus(braked.as_slice(), from, -1.0);
    let braking = norm(brake.as_slice());
    if braking >= most {
        return plus(from, brake.as_slice(), most / braking);
    }
    let rest = plus(to, braked.as_slice(), -1.0);
    // Greatest share of the rest with |brake + share x rest| = most. Both have the same signs, so it is at least 0; and it
    // is below 1, since the whole is more than most.
    let (square, product) = (dot(&rest, &rest), dot(&brake, &rest));
    let root = (product * product + square * (most * most - braking * braking)).max(0.0);
    let share = (root.sqrt() - product) / square.max(f64::MIN_POSITIVE);
    braked.plus(rest, share.clamp(0.0, 1.0))
}

fn dot(a: &Rates, b: &Rates) -> f64 {
    let products = a.as_slice().iter().zip(b.as_slice());
    products.map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::executor::Velocity;

    fn limits() -> Limits {
        Limits::end_effector((0.5, 1.0), (1.0, 10.0))
    }

    fn of(linear: [f64; 3], angular: [f64; 3]) -> Rates {
        Velocity { linear, angular }.into()
    }

    #[test]
    fn a_velocity_beyond_the_limit_keeps_its_direction() {
        let slowed = limits().within(of([3.0, 0.0, -4.0], [0.0, 0.5, 0.0]));
        let slowed = slowed.velocity();
        assert!((slowed.linear[0] - 0.3).abs() < 1e-12);
        assert!((slowed.linear[2] + 0.4).abs() < 1e-12);
        assert_eq!(slowed.angular, [0.0, 0.5, 0.0]);
    }

    #[test]
    fn a_change_takes_its_time_and_arrives_exactly() {
        let target = of([0.25, 0.0, 0.0], [0.0, 0.0, 0.4]);
        let mut velocity = limits().toward(Rates::zero(6), target, 0.1);
        assert!((velocity.velocity().linear[0] - 0.1).abs() < 1e-12);
        assert_eq!(velocity.velocity().angular, target.velocity().angular);
        for _ in 0..2 {
            velocity = limits().toward(velocity, target, 0.1);
        }
        assert_eq!(velocity, target);
        assert_eq!(limits().stopping_time(), 0.5);
    }

    #[test]
    fn braking_goes_first() {
        let of = |linear| of(linear, [0.0; 3]);
        let (from, to) = (of([0.2, -0.05, 0.0]), of([0.0, 0.4, 0.0]));
        let next = limits().toward(from, to, 0.1);
        let [x, y, _] = next.velocity().linear;
        assert!(x < 0.11 && y < 0.0, "{next:?}");
        let later = limits().toward(next, to, 0.15).velocity();
        assert_eq!(later.linear[0], 0.0);
        assert!(later.linear[1] > 0.05, "{later:?}");
    }

    #[test]
    fn each_joint_has_its_own() {
        let joint = |velocity, acceleration| Group {
            axes: 1,
            velocity,
            acceleration,
        };
        let limits = Limits::new(vec![joint(1.0, 1.0), joint(0.2, 4.0)]);
        let slowed = limits.within(Rates::of([-3.0, 0.1]));
        assert_eq!(slowed.as_slice(), [-1.0, 0.1]);
        let next = limits.toward(Rates::zero(2), slowed, 0.05);
        assert_eq!(next.as_slice(), [-0.05, 0.1]);
        assert_eq!(limits.stopping_time(), 1.0);
    }
}
