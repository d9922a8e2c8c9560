//! Numbers along the axes that are commanded.

use wm_motion::actions::MAX_DIMENSIONS;

use super::Velocity;

/// A number along each axis that is commanded: vx, vy, vz \[m/s\], wx, wy, wz \[rad/s\] of an end effector, or one a joint
/// \[rad/s or m/s, or rad or m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    values: [f64; MAX_DIMENSIONS],
    count: usize,
}

impl Rates {
    /// All zero, along `axes` axes, at most as many as an action has values.
    pub fn zero(axes: usize) -> Self {
        Self {
            values: [0.0; MAX_DIMENSIONS],
            count: axes.min(MAX_DIMENSIONS),
        }
    }

    /// The given numbers; no more than an action has values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut rates = Self::zero(0);
        for (slot, value) in rates.values.iter_mut().zip(values) {
            *slot = value;
            rates.count += 1;
        }
        rates
    }

    /// One for each axis.
    pub fn as_slice(&self) -> &[f64] {
        // `zero` and `of` keep the count within the array.
        self.values.get(..self.count).unwrap_or_default()
    }

    /// The same, mutable.
    pub fn as_mut_slice(&mut self) -> &mut [f64] {
        // As in `as_slice`.
        self.values.get_mut(..self.count).unwrap_or_default()
    }

    /// Whether all are zero, exactly.
    pub fn is_zero(&self) -> bool {
        self.as_slice().iter().all(|value| *value == 0.0)
    }

    /// `self` + `share` of `other`.
    #[must_use]
    pub fn plus(mut self, other: Self, share: f64) -> Self {
        for (value, other) in self.as_mut_slice().iter_mut().zip(other.as_slice()) {
            *value += share * other;
        }
        self
    }

    /// The velocity of an end effector, whose six axes these are.
    pub fn velocity(&self) -> Velocity {
        let mut velocity = Velocity::ZERO;
        let slots = velocity.linear.iter_mut().chain(&mut velocity.angular);
        for (slot, value) in slots.zip(self.as_slice()) {
            *slot = *value;
        }
        velocity
    }
}

impl From<Velocity> for Rates {
    fn from(velocity: Velocity) -> Self {
        Self::of(velocity.linear.into_iter().chain(velocity.angular))
    }
}

/// Magnitude.
pub(super) fn norm(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(0.0, |norm: f64, value| norm.hypot(*value))
}

/// `a` + `share` x `b`.
pub(super) fn plus(a: &[f64], b: &[f64], share: f64) -> Rates {
    Rates::of(a.iter().zip(b).map(|(a, b)| a + share * b))
}
