//! From the world's state to parts to draw: the arm, the gripper and the objects.

use nalgebra::{Isometry3, Translation3};
use std::sync::Arc;

use crate::arm::{self, ELBOW_OFFSET_M, FOREARM_M, HAND_M, SHOULDER_HEIGHT_M, UPPER_ARM_M};
use crate::gripper::{FINGER_LENGTH_M, FINGER_THICKNESS_M, FINGER_WIDTH_M, HALF_OPENING_M};
use crate::object::{BOWL_FLOOR_M, BOWL_FOOT, CONE_TIP, Shape};
use crate::render::{Mesh, Part, linear};
use crate::world::World;

/// Mask value of the gripper; the rest of the arm counts as background.
pub const GRIPPER_MASK: u8 = 1;
/// Mask value of the first object; the others follow.
pub const FIRST_OBJECT_MASK: u8 = 2;

#[derive(Clone, Copy)]
enum Link {
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

struct LinkPart {
    link: Link,
    mesh: Arc<Mesh>,
    srgb: [f32; 3],
    gloss: f32,
}

/// The meshes of one episode.
pub struct Scene {
    links: Vec<LinkPart>,
    objects: Vec<Arc<Mesh>>,
}

const DARK: [f32; 3] = [0.20, 0.21, 0.24];
const JOINT: [f32; 3] = [0.34, 0.36, 0.41];
const HAND: [f32; 3] = [0.80, 0.81, 0.84];
/// The two fingers differ from each other and from every object, so that half a turn can be told.
const FINGERS: [[f32; 3]; 2] = [[0.05, 0.78, 0.85], [0.96, 0.36, 0.66]];

impl Scene {
    /// Meshes for the arm and for the world's objects.
    pub fn new(world: &World) -> Self {
        Self {
            links: arm_parts(),
            objects: world
                .objects()
                .iter()
                .map(|object| Arc::new(object_mesh(&object.shape)))
                .collect(),
        }
    }

    /// The parts to draw for the state of `world`.
    pub fn parts(&self, world: &World) -> Vec<Part> {
        let tool = world.tool().frame();
        let mut parts = Vec::with_capacity(self.links.len() + self.objects.len());
        if let Some(joints) = arm::inverse(&tool) {
            let links = arm::forward(&joints);
            for part in &self.links {
                let (pose, mask) = match part.link {
                    Link::Base => (Isometry3::identity(), 0),
                    Link::Waist => (links.waist, 0),
                    Link::UpperArm => (links.upper_arm, 0),
                    Link::Forearm => (links.forearm, 0),
                    Link::ForearmRoll => (links.forearm_roll, 0),
                    Link::Wrist => (links.wrist, GRIPPER_MASK),
                    Link::Hand => (links.tool, GRIPPER_MASK),
                    Link::Finger(side) => {
                        let sign = if side == 0 { -1.0 } else { 1.0 };
                        let out = sign * world.opening() * HALF_OPENING_M;
                        (links.tool * Translation3::new(0.0, out, 0.0), GRIPPER_MASK)
                    }
                };
                parts.push(Part {
                    mesh: part.mesh.clone(),
                    pose: pose.cast(),
                    albedo: linear(part.srgb),
                    gloss: part.gloss,
                    mask,
                });
            }
        }
        for (index, (object, mesh)) in world.objects().iter().zip(&self.objects).enumerate() {
            parts.push(Part {
                mesh: mesh.clone(),
                pose: object.pose.cast(),
                albedo: linear(object.colour.srgb),
                gloss: 0.12,
                // A scene has at most four objects.
                mask: FIRST_OBJECT_MASK + index as u8,
            });
        }
        parts
    }
}

/// Proportions of links that carry no kinematics are chosen by eye after the real arm; metres.
fn arm_parts() -> Vec<LinkPart> {
    let part = |link, mesh, srgb, gloss| LinkPart {
        link,
        mesh: Arc::new(mesh),
        srgb,
        gloss,
    };
    let [upper, offset, forearm, hand] =
        [UPPER_ARM_M, ELBOW_OFFSET_M, FOREARM_M, HAND_M].map(|length| length as f32);
    let shoulder = SHOULDER_HEIGHT_M as f32;
    let across = |radius: f32, length: f32| {
        Mesh::cylinder(radius, length)
            .lying_along_y()
            .shifted(0.0, -length / 2.0, 0.0)
    };
    let (length, thick, wide) = (
        FINGER_LENGTH_M as f32,
        FINGER_THICKNESS_M as f32,
        FINGER_WIDTH_M as f32 / 2.0,
    );
    // Each finger in the tool's frame at zero opening: inner face at y = 0, tip at x = 0.
    let finger = |sign: f32| {
        let (low, high) = if sign < 0.0 {
            (-thick, 0.0)
        } else {
            (0.0, thick)
        };
        Mesh::cuboid([-length, low, -wide], [0.0, high, wide])
    };
    // The bar that the fingers slide on, and its far end towards the wrist.
    let bar = -length;
    vec![
        part(
            Link::Base,
            Mesh::cuboid([-0.10, -0.065, 0.0], [0.075, 0.065, 0.022]),
            DARK,
            0.1,
        ),
        part(
            Link::Base,
            Mesh::cylinder(0.052, shoulder - 0.035),
            DARK,
            0.1,
        ),
        part(
            Link::Waist,
            Mesh::cuboid([-0.038, -0.045, -0.035], [0.038, 0.045, 0.02]),
            JOINT,
            0.1,
        ),
        part(Link::UpperArm, across(0.034, 0.10), JOINT, 0.2),
        part(
            Link::UpperArm,
            Mesh::cuboid([-0.026, -0.024, 0.0], [0.024, 0.024, upper + 0.024]),
            DARK,
            0.15,
        ),
        part(
            Link::UpperArm,
            Mesh::cuboid([0.0, -0.02, upper - 0.024], [offset, 0.02, upper + 0.024]),
            DARK,
            0.15,
        ),
        part(Link::Forearm, across(0.031, 0.07), JOINT, 0.2),
        part(
            Link::Forearm,
            Mesh::cuboid([0.0, -0.022, -0.022], [0.175, 0.022, 0.022]),
            DARK,
            0.15,
        ),
        part(
            Link::ForearmRoll,
            Mesh::cylinder(0.021, 0.07)
                .lying_along_x()
                .shifted(0.170 - forearm, 0.0, 0.0),
            JOINT,
            0.2,
        ),
        part(Link::ForearmRoll, across(0.026, 0.056), DARK, 0.2),
        part(
            Link::Wrist,
            Mesh::cylinder(0.022, 0.045)
                .lying_along_x()
                .shifted(0.012, 0.0, 0.0),
            JOINT,
            0.2,
        ),
        part(
            Link::Hand,
            Mesh::cuboid([0.054 - hand, -0.026, -0.022], [bar - 0.022, 0.026, 0.022]),
            JOINT,
            0.2,
        ),
        // The long light bar shows the yaw; the knob on one side tells front from back.
        part(
            Link::Hand,
            Mesh::cuboid([bar - 0.026, -0.058, -0.019], [bar, 0.058, 0.019]),
            HAND,
            0.25,
        ),
        part(
            Link::Hand,
            Mesh::cuboid([bar - 0.026, -0.015, 0.019], [bar - 0.004, 0.015, 0.034]),
            FINGER_KNOB,
            0.1,
        ),
        part(Link::Finger(0), finger(-1.0), FINGERS[0], 0.2),
        part(Link::Finger(1), finger(1.0), FINGERS[1], 0.2),
    ]
}

const FINGER_KNOB: [f32; 3] = [0.96, 0.93, 0.30];

fn object_mesh(shape: &Shape) -> Mesh {
    // Single precision is ample for a picture.
    match *shape {
        Shape::Box {
            half_x,
            half_y,
            height,
        } => {
            let (x, y) = (half_x as f32, half_y as f32);
            Mesh::cuboid([-x, -y, 0.0], [x, y, height as f32])
        }
        Shape::Cylinder { radius, height } => Mesh::cylinder(radius as f32, height as f32),
        Shape::Ball { radius } => Mesh::ball(radius as f32),
        Shape::Cone { radius, height } => {
            let (radius, height) = (radius as f32, height as f32);
            Mesh::turned(&[
                (0.0, 0.0),
                (radius, 0.0),
                (radius * CONE_TIP as f32, height),
                (0.0, height),
            ])
        }
        Shape::Bowl { radius, height } => bowl(radius as f32, height as f32),
    }
}

/// A bowl: up along the outside, over the rim, down along the inside.
fn bowl(radius: f32, height: f32) -> Mesh {
    const BANDS: usize = 6;
    let wall = 0.1 * radius;
    let floor = BOWL_FLOOR_M as f32;
    // The radius grows with the square root of the height: a rounded wall.
    let outer = |share: f32| {
        (
            radius * (BOWL_FOOT as f32 + (1.0 - BOWL_FOOT as f32) * share.sqrt()),
            height * share,
        )
    };
    let steps = || (0..=BANDS).map(|i| (i as f32 / BANDS as f32).powi(2));
    let mut profile = vec![(0.0, 0.0)];
    profile.extend(steps().map(outer));
    let mut inner: Vec<_> = steps()
        .map(|share| {
            let (r, z) = outer(share);
            (r - wall, floor + z * (height - floor) / height)
        })
        .collect();
    inner.reverse();
    profile.extend(inner);
    profile.push((0.0, floor));
    Mesh::turned(&profile)
}
