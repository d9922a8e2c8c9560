//! Gestures of the hand apart from its task: it turns, and opens and closes.
//!
//! People do this to try the gripper and to see around it; here it also makes turns and openings frequent enough for
//! learning.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Shortest and longest gesture, actions.
const FRAMES: std::ops::RangeInclusive<usize> = 2..=5;
/// Probability of a turn about an axis, and its limits, radians: roll, pitch, yaw.
const TURN_SHARE: f64 = 0.6;
const LARGEST_TURN_RAD: [f64; 3] = [0.5, 0.5, 0.6];
/// Probability that a gesture moves the gripper.
const GRIPPER_SHARE: f64 = 0.4;

/// The present gesture.
#[derive(Default)]
pub struct Gesture {
    turn: Vector3<f64>,
    gripper: bool,
    frames: usize,
}

impl Gesture {
    /// Advances by one action: continues the gesture or starts the next.
    pub fn advance(&mut self, rng: &mut ChaCha8Rng) {
        if self.frames > 0 {
            self.frames -= 1;
            return;
        }
        self.frames = rng.random_range(FRAMES);
        self.turn = Vector3::from(LARGEST_TURN_RAD).map(|largest| {
            if rng.random_bool(TURN_SHARE) {
                rng.random_range(-largest..largest)
            } else {
                0.0
            }
        });
        self.gripper = rng.random_bool(GRIPPER_SHARE);
    }

    /// Turn added to the hand's, radians.
    pub fn turn(&self) -> Vector3<f64> {
        self.turn
    }

    /// Whether the gesture inverts the gripper of the move.
    pub fn inverts_gripper(&self) -> bool {
        self.gripper
    }
}
