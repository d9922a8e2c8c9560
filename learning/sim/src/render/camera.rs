//! The fixed camera, and the light's parallel projection.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// Width and height of the pictures, pixels.
pub const IMAGE_SIZE: u32 = 256;

/// A projection to the screen whose third value grows towards the viewer and is linear over a projected triangle, so that
/// it serves as depth.
pub trait Projection {
    /// Screen x and y in pixels and nearness, or `None` behind the viewer.
    fn project(&self, point: &Vector3<f32>) -> Option<[f32; 3]>;
}

/// A pinhole camera with its x to the right and its y down the picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    eye: Vector3<f32>,
    target: Vector3<f32>,
    right: Vector3<f32>,
    down: Vector3<f32>,
    ahead: Vector3<f32>,
    /// Focal length in pixels of a picture of [`IMAGE_SIZE`].
    focal_px: f32,
}

impl Camera {
    /// The usual camera: at the right of the arm, looking across and down at the workspace, which fills most of the picture.
    pub fn beside_the_arm() -> Self {
        let eye = Vector3::new(0.225, -0.47, 0.475);
        let target = Vector3::new(0.262, 0.0, 0.095);
        Self::look_at(eye, target, 0.0)
    }

    /// A second camera: in front of the arm, looking back at it and down at the workspace.
    pub fn facing_the_arm() -> Self {
        let eye = Vector3::new(0.84, 0.0, 0.38);
        let target = Vector3::new(0.24, 0.0, 0.06);
        Self::look_at(eye, target, 0.0)
    }

    /// A camera at `eye` that looks at `target` (metres), turned about its view axis by `roll` radians.
    fn look_at(eye: Vector3<f32>, target: Vector3<f32>, roll: f32) -> Self {
        let ahead = (target - eye).normalize();
        let level = ahead.cross(&Vector3::z()).normalize();
        let (sin, cos) = roll.sin_cos();
        let right = level * cos + ahead.cross(&level) * sin;
        Self {
            eye,
            target,
            right,
            down: ahead.cross(&right),
            ahead,
            focal_px: 455.0,
        }
    }

    /// The camera moved by `shift` and aimed `aim` beside its target (metres), then turned about its view
    /// axis by `roll` radians.
    pub fn moved(&self, shift: Vector3<f32>, aim: Vector3<f32>, roll: f32) -> Self {
        Self::look_at(self.eye + shift, self.target + aim, roll)
    }

    /// Position, metres.
    pub fn eye(&self) -> Vector3<f32> {
        self.eye
    }

    /// Focal length, pixels of a picture of [`IMAGE_SIZE`]. The principal point is the centre; there is no distortion.
    pub fn focal_px(&self) -> f64 {
        f64::from(self.focal_px)
    }

    /// The optical frame in the base frame: x to the right of the picture, y down it, z ahead (REP 103).
    pub fn base_from_optical(&self) -> Isometry3<f64> {
        let axes = Matrix3::from_columns(&[self.right, self.down, self.ahead]);
        // Orthogonal up to rounding in single precision.
        let turn = Rotation3::from_matrix(&axes.cast::<f64>());
        let turn = UnitQuaternion::from_rotation_matrix(&turn);
        Isometry3::from_parts(self.eye.cast::<f64>().into(), turn)
    }

    /// Horizontal unit vectors to the viewer's right and away from the viewer, which instructions call left and right, front
    /// and behind.
    pub fn viewer_axes(&self) -> [Vector3<f32>; 2] {
        let flat = Vector3::new(self.ahead.x, self.ahead.y, 0.0).normalize();
        [Vector3::new(flat.y, -flat.x, 0.0), flat]
    }

    /// Direction of the ray through a point of the picture, scaled to one metre along the view axis.
    pub fn ray(&self, x_px: f32, y_px: f32) -> Vector3<f32> {
        let middle = IMAGE_SIZE as f32 / 2.0;
        self.ahead
            + self.right * ((x_px - middle) / self.focal_px)
            + self.down * ((y_px - middle) / self.focal_px)
    }

    /// Projects a point of the base frame to pixels; `None` behind the camera.
    pub fn pixel(&self, point: &Point3<f64>) -> Option<[f32; 2]> {
        let [x, y, _] = self.project(&point.coords.cast())?;
        Some([x, y])
    }
}

impl Projection for Camera {
    fn project(&self, point: &Vector3<f32>) -> Option<[f32; 3]> {
        let offset = point - self.eye;
        let depth = offset.dot(&self.ahead);
        // No part comes nearer than this.
        if depth < 0.05 {
            return None;
        }
        let middle = IMAGE_SIZE as f32 / 2.0;
        Some([
            middle + self.focal_px * offset.dot(&self.right) / depth,
            middle + self.focal_px * offset.dot(&self.down) / depth,
            1.0 / depth,
        ])
    }
}

/// The key light: parallel rays, and the projection to its shadow map.
#[derive(Clone, Debug)]
pub struct Light {
    /// Unit vector towards the light.
    pub towards: Vector3<f32>,
    across: Vector3<f32>,
    along: Vector3<f32>,
}

/// Width and height of the shadow map, in cells.
pub const SHADOW_SIZE: usize = 320;
/// Resolution of the shadow map, cells per metre: 2.5 mm each.
const SHADOW_CELLS_M: f32 = 400.0;
/// Centre of the shadow map, metres.
const SHADOW_MIDDLE: [f32; 3] = [0.20, 0.02, 0.0];

impl Light {
    /// A light from this direction, of any length.
    pub fn new(direction: Vector3<f32>) -> Self {
        let towards = direction.normalize();
        let across = towards.cross(&Vector3::y()).normalize();
        Self {
            towards,
            across,
            along: towards.cross(&across),
        }
    }

    /// Place in the shadow map (cells) and height along the light (metres).
    pub fn place(&self, point: &Vector3<f32>) -> [f32; 3] {
        let offset = point - Vector3::from(SHADOW_MIDDLE);
        let middle = SHADOW_SIZE as f32 / 2.0;
        [
            middle + SHADOW_CELLS_M * offset.dot(&self.across),
            middle + SHADOW_CELLS_M * offset.dot(&self.along),
            offset.dot(&self.towards),
        ]
    }
}

impl Projection for Light {
    fn project(&self, point: &Vector3<f32>) -> Option<[f32; 3]> {
        Some(self.place(point))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::WORKSPACE_M;

    #[test]
    fn whole_workspace_is_in_view() {
        let [low, high] = WORKSPACE_M;
        for camera in [Camera::beside_the_arm(), Camera::facing_the_arm()] {
            for corner in 0..8 {
                let at = |axis: usize| {
                    if corner >> axis & 1 == 0 {
                        low[axis]
                    } else {
                        high[axis]
                    }
                };
                let [x, y] = camera
                    .pixel(&Point3::new(at(0), at(1), at(2)))
                    .expect("in front");
                let inside = 0.0..f32::from(256_u16);
                assert!(inside.contains(&x) && inside.contains(&y), "{x} {y}");
            }
        }
    }

    #[test]
    fn focal_length_and_frame_give_the_pixel_of_a_point() {
        let camera = Camera::beside_the_arm().moved(
            Vector3::new(0.01, -0.02, 0.015),
            Vector3::new(-0.01, 0.01, 0.0),
            0.03,
        );
        let point = Point3::new(0.3, -0.05, 0.1);
        let seen = camera.pixel(&point).expect("in front");
        let optical = camera.base_from_optical().inverse() * point;
        let middle = f64::from(IMAGE_SIZE) / 2.0;
        let project = |along: f64| middle + camera.focal_px() * along / optical.z;
        for (found, expected) in [project(optical.x), project(optical.y)].iter().zip(seen) {
            assert!(
                (found - f64::from(expected)).abs() < 1e-3,
                "{found} {expected}"
            );
        }
    }
}
