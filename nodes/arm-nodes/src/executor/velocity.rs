//! The velocity of an end effector.

/// Three numbers along the axes of the robot's base.
pub(super) type Axes = [f64; 3];

/// The velocity of an end effector, in the robot's base frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Of its position \[m/s\].
    pub linear: [f64; 3],
    /// Of its orientation, about the axes of the base \[rad/s\].
    pub angular: [f64; 3],
}

impl Velocity {
    /// Standing still.
    pub const ZERO: Self = Self {
        linear: [0.0; 3],
        angular: [0.0; 3],
    };

    /// Whether it stands still, exactly.
    pub fn is_zero(&self) -> bool {
        *self == Self::ZERO
    }

    /// `self` + `share` of `other`.
    pub(crate) fn plus(self, other: Self, share: f64) -> Self {
        Self {
            linear: plus(self.linear, other.linear, share),
            angular: plus(self.angular, other.angular, share),
        }
    }
}

/// `a` + `share` x `b`.
pub(super) fn plus(a: Axes, b: Axes, share: f64) -> Axes {
    let [ax, ay, az] = a;
    let [bx, by, bz] = b;
    [ax + share * bx, ay + share * by, az + share * bz]
}

/// Magnitude.
pub(super) fn norm([x, y, z]: Axes) -> f64 {
    x.hypot(y).hypot(z)
}
