//! The velocity of an end effector.

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

    /// `self` + `share` of `other`.
    pub(crate) fn plus(self, other: Self, share: f64) -> Self {
        let plus = |a: [f64; 3], b: [f64; 3]| {
            let ([ax, ay, az], [bx, by, bz]) = (a, b);
            [ax + share * bx, ay + share * by, az + share * bz]
        };
        Self {
            linear: plus(self.linear, other.linear),
            angular: plus(self.angular, other.angular),
        }
    }
}
