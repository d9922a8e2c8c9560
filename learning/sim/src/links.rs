//! The shapes and colours of the arm and the gripper.
//!
//! The gripper is readable in a picture of 128 pixels: fingers of different colours with light inner faces (position and
//! opening), dark tips (which end is down), and a palm that is light on one side and striped, with a fin, on the other, so
//! that no turn looks like another or like a shift.

use std::sync::Arc;

use crate::arm::{ELBOW_OFFSET_M, FOREARM_M, HAND_M, SHOULDER_HEIGHT_M, UPPER_ARM_M};
use crate::gripper::{FINGER_LENGTH_M, FINGER_THICKNESS_M, FINGER_WIDTH_M};
use crate::render::Mesh;

/// The link to which a part is fixed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Link {
    Base,
    Waist,
    UpperArm,
    Forearm,
    ForearmRoll,
    Wrist,
    Hand,
    /// The finger on the side of negative (0) or positive (1) y.
    Finger(usize),
}

/// An axis of a link's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Axis {
    X,
    Y,
    Z,
}

/// The form of a part in its link's frame, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    Cuboid {
        low: [f32; 3],
        high: [f32; 3],
    },
    Cylinder {
        axis: Axis,
        radius: f32,
        /// Start on the axis.
        from: f32,
        length: f32,
    },
}

impl Form {
    fn mesh(self) -> Mesh {
        match self {
            Self::Cuboid { low, high } => Mesh::cuboid(low, high),
            Self::Cylinder {
                axis,
                radius,
                from,
                length,
            } => {
                let upright = Mesh::cylinder(radius, length);
                match axis {
                    Axis::X => upright.along_x().shift(from, 0.0, 0.0),
                    Axis::Y => upright.along_y().shift(0.0, from, 0.0),
                    Axis::Z => upright.shift(0.0, 0.0, from),
                }
            }
        }
    }
}

/// A form in its link's frame, its mesh, and its surface.
#[derive(Clone)]
pub struct LinkPart {
    pub link: Link,
    pub form: Form,
    pub mesh: Arc<Mesh>,
    pub srgb: [f32; 3],
    pub gloss: f32,
}

impl LinkPart {
    fn new(link: Link, form: Form, srgb: [f32; 3], gloss: f32) -> Self {
        Self {
            link,
            form,
            mesh: Arc::new(form.mesh()),
            srgb,
            gloss,
        }
    }
}

fn cuboid(low: [f32; 3], high: [f32; 3]) -> Form {
    Form::Cuboid { low, high }
}

/// Depth of the palm, metres.
const PALM_M: f32 = 0.024;

const DARK: [f32; 3] = [0.20, 0.21, 0.24];
const JOINT: [f32; 3] = [0.34, 0.36, 0.41];
const LIGHT: [f32; 3] = [0.90, 0.91, 0.93];
const BLACK: [f32; 3] = [0.07, 0.07, 0.09];
const FIN: [f32; 3] = [0.98, 0.94, 0.25];
/// Different for the two fingers and from all objects, so that half a turn is visible.
const FINGERS: [[f32; 3]; 2] = [[0.05, 0.72, 0.82], [0.94, 0.28, 0.62]];
/// Their inner faces: brighter, so that the opening is visible.
const INNER: [[f32; 3]; 2] = [[0.80, 1.0, 1.0], [1.0, 0.86, 0.95]];

/// The parts of the arm. Proportions without effect on kinematics are estimates of the real arm; metres.
pub fn arm_parts() -> Vec<LinkPart> {
    let [upper, offset, forearm] =
        [UPPER_ARM_M, ELBOW_OFFSET_M, FOREARM_M].map(|length| length as f32);
    let shoulder = SHOULDER_HEIGHT_M as f32;
    let cylinder = |axis: Axis, radius: f32, from: f32, length: f32| Form::Cylinder {
        axis,
        radius,
        from,
        length,
    };
    let across = |radius: f32, length: f32| cylinder(Axis::Y, radius, -length / 2.0, length);
    let part = LinkPart::new;
    let mut parts = vec![
        part(
            Link::Base,
            cuboid([-0.10, -0.065, 0.0], [0.075, 0.065, 0.022]),
            DARK,
            0.1,
        ),
        part(
            Link::Base,
            cylinder(Axis::Z, 0.052, 0.0, shoulder - 0.035),
            DARK,
            0.1,
        ),
        part(
            Link::Waist,
            cuboid([-0.038, -0.045, -0.035], [0.038, 0.045, 0.02]),
            JOINT,
            0.1,
        ),
        part(Link::UpperArm, across(0.034, 0.10), JOINT, 0.2),
        part(
            Link::UpperArm,
            cuboid([-0.026, -0.024, 0.0], [0.024, 0.024, upper + 0.024]),
            DARK,
            0.15,
        ),
        part(
            Link::UpperArm,
            cuboid([0.0, -0.02, upper - 0.024], [offset, 0.02, upper + 0.024]),
            DARK,
            0.15,
        ),
        part(Link::Forearm, across(0.031, 0.07), JOINT, 0.2),
        part(
            Link::Forearm,
            cuboid([0.0, -0.022, -0.022], [0.175, 0.022, 0.022]),
            DARK,
            0.15,
        ),
        part(
            Link::ForearmRoll,
            cylinder(Axis::X, 0.021, 0.170 - forearm, 0.07),
            JOINT,
            0.2,
        ),
        part(Link::ForearmRoll, across(0.024, 0.050), DARK, 0.2),
        part(
            Link::Wrist,
            cylinder(Axis::X, 0.021, 0.012, 0.045),
            JOINT,
            0.2,
        ),
    ];
    parts.extend(palm_parts());
    for side in [0, 1] {
        parts.extend(finger_parts(side));
    }
    parts
}

/// The palm in the hand's frame: light at negative y; striped, with a fin, at positive y.
fn palm_parts() -> Vec<LinkPart> {
    let hand = HAND_M as f32;
    // The side on which the fingers slide, and the side of the wrist.
    let (near, far) = (-FINGER_LENGTH_M as f32, -FINGER_LENGTH_M as f32 - PALM_M);
    let part = |form, srgb, gloss| LinkPart::new(Link::Hand, form, srgb, gloss);
    let mut parts = vec![
        part(
            cuboid([0.050 - hand, -0.024, -0.020], [far, 0.024, 0.020]),
            JOINT,
            0.2,
        ),
        part(
            cuboid([far, -0.068, -0.024], [near, 0.0, 0.024]),
            LIGHT,
            0.25,
        ),
        // Only on the viewer's side at zero yaw: front and back differ.
        part(
            cuboid([far + 0.005, -0.044, 0.024], [near - 0.005, -0.020, 0.029]),
            BLACK,
            0.1,
        ),
        part(
            cuboid([far - 0.030, 0.052, -0.020], [far, 0.068, 0.020]),
            FIN,
            0.1,
        ),
    ];
    const STRIPES: usize = 4;
    for stripe in 0..STRIPES {
        let width = 0.068 / STRIPES as f32;
        let from = width * stripe as f32;
        let srgb = if stripe % 2 == 0 { BLACK } else { LIGHT };
        parts.push(part(
            cuboid([far, from, -0.024], [near, from + width, 0.024]),
            srgb,
            0.15,
        ));
    }
    parts
}

/// A finger in the hand's frame at zero opening: its inner face at y = 0, its tip at x = 0.
fn finger_parts(side: usize) -> Vec<LinkPart> {
    let (length, thick, wide) = (
        FINGER_LENGTH_M as f32,
        FINGER_THICKNESS_M as f32,
        FINGER_WIDTH_M as f32 / 2.0,
    );
    let inner_thick = 0.4 * thick;
    let sign = if side == 0 { -1.0 } else { 1.0 };
    // A cuboid between two distances from the inner face.
    let slab = |from_x: f32, to_x: f32, from: f32, to: f32| {
        let (low, high) = if sign < 0.0 { (-to, -from) } else { (from, to) };
        cuboid([from_x, low, -wide], [to_x, high, wide])
    };
    // In range: `side` is 0 or 1.
    let pick = |colours: &[[f32; 3]; 2]| colours.get(side).copied().unwrap_or(LIGHT);
    let part = |form, srgb| LinkPart::new(Link::Finger(side), form, srgb, 0.15);
    // Its slide goes around the palm, so that the opening is visible from above too.
    let (inside, outside) = if sign < 0.0 {
        (-thick, 0.0)
    } else {
        (0.0, thick)
    };
    let carriage = part(
        cuboid(
            [-length - PALM_M - 0.008, inside, -0.031],
            [-length + 0.002, outside, 0.031],
        ),
        pick(&FINGERS),
    );
    // The tip's dark band, longer on one finger.
    let band = if side == 0 { 0.012 } else { 0.022 };
    vec![
        part(slab(-length, -band, inner_thick, thick), pick(&FINGERS)),
        part(slab(-band, 0.0, inner_thick, thick), BLACK),
        part(slab(-length, 0.0, 0.0, inner_thick), pick(&INNER)),
        carriage,
    ]
}
