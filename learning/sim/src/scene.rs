//! Converts a world's state to parts to draw: arm, gripper and objects.

use nalgebra::{Isometry3, Translation3};
use std::sync::Arc;

use crate::arm;
use crate::gripper::{self, HALF_OPENING_M};
use crate::links::{Link, LinkPart, arm_parts};
use crate::object::{BOWL_FLOOR_M, BOWL_FOOT, CONE_TIP, MAT_HEIGHT_M, Shape};
use crate::render::{Mesh, Part, linear};
use crate::world::World;

/// Mask value of the gripper; the rest of the arm counts as background.
pub const GRIPPER_MASK: u8 = 1;
/// Mask value of the first object; the others follow.
pub const FIRST_OBJECT_MASK: u8 = 2;

/// The meshes of one episode.
#[derive(Clone)]
pub struct Scene {
    links: Vec<LinkPart>,
    objects: Vec<Arc<Mesh>>,
}

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
            let hand = gripper::hand(&links.tool);
            for part in &self.links {
                let (pose, mask) = match part.link {
                    Link::Base => (Isometry3::identity(), 0),
                    Link::Waist => (links.waist, 0),
                    Link::UpperArm => (links.upper_arm, 0),
                    Link::Forearm => (links.forearm, 0),
                    Link::ForearmRoll => (links.forearm_roll, 0),
                    Link::Wrist => (links.wrist, GRIPPER_MASK),
                    Link::Hand => (hand, GRIPPER_MASK),
                    Link::Finger(side) => {
                        let sign = if side == 0 { -1.0 } else { 1.0 };
                        let out = sign * world.opening() * HALF_OPENING_M;
                        (hand * Translation3::new(0.0, out, 0.0), GRIPPER_MASK)
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
                // Fits: a scene has at most four objects and two mats.
                mask: FIRST_OBJECT_MASK + index as u8,
            });
        }
        parts
    }
}

fn object_mesh(shape: &Shape) -> Mesh {
    // Single precision suffices for a picture.
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
            Mesh::revolve_profile(&[
                (0.0, 0.0),
                (radius, 0.0),
                (radius * CONE_TIP as f32, height),
                (0.0, height),
            ])
        }
        Shape::Mat { radius } => Mesh::cylinder(radius as f32, MAT_HEIGHT_M as f32),
        Shape::Bowl { radius, height } => bowl_mesh(radius as f32, height as f32),
    }
}

/// A bowl: up the outside, over the rim, down the inside.
fn bowl_mesh(radius: f32, height: f32) -> Mesh {
    const BANDS: usize = 6;
    let wall = 0.1 * radius;
    let floor = BOWL_FLOOR_M as f32;
    // A rounded wall: the radius grows with the square root of the height.
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
    Mesh::revolve_profile(&profile)
}

#[cfg(test)]
mod tests;
