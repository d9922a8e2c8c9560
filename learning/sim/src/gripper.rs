//! The gripper's geometry: two parallel fingers on a palm.
//!
//! Larger than the real one, so that turn and opening show in a small picture. It is also mounted a quarter turn from the
//! real one: at zero yaw, its fingers open across the camera's view; along it, one
//! finger would hide the other.

use nalgebra::{Isometry3, Point3, Vector3};

/// Distance of each finger's inner face from the middle when fully open, metres.
pub const HALF_OPENING_M: f64 = 0.040;
/// Length of the fingers, metres.
pub const FINGER_LENGTH_M: f64 = 0.078;
/// Thickness of a finger along the opening, metres.
pub const FINGER_THICKNESS_M: f64 = 0.019;
/// Width of a finger across the opening, metres.
pub const FINGER_WIDTH_M: f64 = 0.036;
/// Radius of the spheres that model a finger in contacts, metres: half of its thickness.
pub const CONTACT_RADIUS_M: f64 = FINGER_THICKNESS_M / 2.0;

/// Sides of the two fingers along the hand's y axis.
pub const SIDES: [f64; 2] = [-1.0, 1.0];

/// The hand's frame for a tool at `tool`: x ahead of the hand, y along the fingers' opening (the base's
/// x, right in the picture, at zero angles), z across it (towards the viewer at zero angles).
pub fn hand(tool: &Isometry3<f64>) -> Isometry3<f64> {
    tool * Isometry3::rotation(Vector3::x() * std::f64::consts::FRAC_PI_2)
}

/// The centres of the spheres that model the two fingers, in the base frame (metres), with the
/// hand opened to `opening` (0 closed to 1 open) and the tool at `tool`.
pub fn contact_spheres(tool: &Isometry3<f64>, opening: f64) -> Vec<Point3<f64>> {
    let hand = hand(tool);
    let mut spheres = Vec::with_capacity(18);
    for side in SIDES {
        let y = side * (opening * HALF_OPENING_M + CONTACT_RADIUS_M);
        for up in [CONTACT_RADIUS_M, 0.026, 0.048] {
            for z in [-0.010, 0.0, 0.010] {
                spheres.push(hand * Point3::new(-up, y, z));
            }
        }
    }
    spheres
}

/// Height of the lowest point of the fingers over the table, metres.
pub fn lowest(tool: &Isometry3<f64>, opening: f64) -> f64 {
    let hand = hand(tool);
    let mut lowest = f64::INFINITY;
    for side in SIDES {
        for y in [
            opening * HALF_OPENING_M,
            opening * HALF_OPENING_M + FINGER_THICKNESS_M,
        ] {
            for z in [-FINGER_WIDTH_M / 2.0, FINGER_WIDTH_M / 2.0] {
                lowest = lowest.min((hand * Point3::new(0.0, side * y, z)).z);
            }
        }
    }
    lowest
}
