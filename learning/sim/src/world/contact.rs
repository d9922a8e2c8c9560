//! Contacts: objects give way, ride on each other and fall.

use nalgebra::{Vector2, Vector3};

use super::{TOUCH_M, World};
use crate::gripper::{self, CONTACT_RADIUS_M};
use crate::object::{BOWL_FLOOR_M, Object, Shape};

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.81;

impl World {
    /// Pushes objects with the fingers.
    pub(super) fn fingers_push(&mut self, moved: Vector2<f64>) {
        let spheres = gripper::contact_spheres(&self.tool.frame(), self.opening);
        let held = self.held();
        for index in 0..self.objects.len() {
            if Some(index) == held || self.is_mat(index) {
                continue;
            }
            for sphere in &spheres {
                let Some(object) = self.objects.get(index) else {
                    continue;
                };
                let level = sphere.z - object.position().z;
                if level - CONTACT_RADIUS_M > object.shape.height() - TOUCH_M
                    || level + CONTACT_RADIUS_M < 0.0
                {
                    continue;
                }
                let offset = sphere.coords.xy() - object.position().xy();
                if matches!(object.shape, Shape::Bowl { radius, .. } if offset.norm() < 0.7 * radius
                    && moved.dot(&offset) <= 0.0)
                {
                    // Inside a bowl, without motion towards its wall.
                    continue;
                }
                let own = object.base_to_own(offset);
                if let Some((depth, away)) = object.shape.overlap(own, CONTACT_RADIUS_M, level) {
                    self.push(index, offset, object.own_to_base(away) * depth);
                }
            }
        }
    }

    fn is_mat(&self, index: usize) -> bool {
        self.objects
            .get(index)
            .is_some_and(|object| matches!(object.shape, Shape::Mat { .. }))
    }

    /// Moves object `index` so that its point at `arm` (from its middle, metres) gives way by `give`. Shift and turn share the
    /// motion as for friction of its footprint with the table (an ellipsoidal limit surface).
    ///
    fn push(&mut self, index: usize, arm: Vector2<f64>, give: Vector2<f64>) {
        let depth = give.norm();
        let Some(object) = self.objects.get(index) else {
            return;
        };
        if depth < 1e-9 {
            return;
        }
        let normal = give / depth;
        let (shift, turn) = match object.shape {
            Shape::Box { half_x, half_y, .. } => {
                let moment = arm.x * normal.y - arm.y * normal.x;
                // Radius of friction of a rectangle, about 0.6 of its half diagonal.
                let friction = (0.6 * half_x.hypot(half_y)).powi(2);
                let scale = depth / (friction + moment * moment);
                (normal * (scale * friction), scale * moment)
            }
            _ => (give, 0.0),
        };
        self.carry(index, shift, turn);
    }

    /// Shifts and turns an object with the objects on it.
    pub(super) fn carry(&mut self, index: usize, shift: Vector2<f64>, turn: f64) {
        let Some(base) = self.objects.get(index).cloned() else {
            return;
        };
        let held = self.held();
        for (other, object) in self.objects.iter_mut().enumerate() {
            let rides = other != index
                && Some(other) != held
                && (object.position().z - floor_under(object, &base)).abs() < TOUCH_M
                && (object.position() - base.position()).xy().norm() < base.shape.bounding_radius()
                && base.shape.carries();
            if other == index || rides {
                object.pose.translation.vector.x += shift.x;
                object.pose.translation.vector.y += shift.y;
            }
            if other == index {
                object.pose.rotation =
                    nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn)
                        * object.pose.rotation;
            }
        }
    }

    /// Pushes objects with the held one.
    pub(super) fn held_pushes_others(&mut self, held: usize) {
        let Some(object) = self.objects.get(held).cloned() else {
            return;
        };
        for index in 0..self.objects.len() {
            let Some(other) = self.objects.get(index) else {
                continue;
            };
            if index == held
                || self.is_mat(index)
                || object.lowest() > floor_under(&object, other) - TOUCH_M
            {
                continue;
            }
            let apart = (other.position() - object.position()).xy();
            let depth = object.shape.contact_radius() + other.shape.contact_radius() - apart.norm();
            if depth > 0.0 && apart.norm() > 1e-6 {
                self.push(
                    index,
                    -apart.normalize() * other.shape.contact_radius(),
                    apart.normalize() * depth,
                );
            }
        }
    }

    pub(super) fn objects_push_each_other(&mut self) {
        let held = self.held();
        for first in 0..self.objects.len() {
            for second in 0..self.objects.len() {
                let (Some(a), Some(b)) = (self.objects.get(first), self.objects.get(second)) else {
                    continue;
                };
                let flat =
                    matches!(a.shape, Shape::Mat { .. }) || matches!(b.shape, Shape::Mat { .. });
                if flat || first == second || Some(first) == held || Some(second) == held {
                    continue;
                }
                // `a` is the higher one; resting on the other is not a collision.
                if a.position().z < b.position().z
                    || a.position().z > floor_under(a, b) - TOUCH_M && b.shape.carries()
                    || a.position().z > b.top()
                {
                    continue;
                }
                let apart = (b.position() - a.position()).xy();
                let depth = a.shape.contact_radius() + b.shape.contact_radius() - apart.norm();
                if depth > 1e-6 && apart.norm() > 1e-6 {
                    let normal = apart.normalize();
                    self.carry(first, normal * (-0.5 * depth), 0.0);
                    self.carry(second, normal * (0.5 * depth), 0.0);
                }
            }
        }
    }

    /// Lets objects fall for `time_s` seconds, down to the support below.
    pub(super) fn fall(&mut self, time_s: f64) {
        let held = self.held();
        for index in 0..self.objects.len() {
            let Some(object) = self.objects.get(index) else {
                continue;
            };
            if Some(index) == held {
                continue;
            }
            let mut support = 0.0_f64;
            for (other_index, other) in self.objects.iter().enumerate() {
                if other_index == index || Some(other_index) == held || !other.shape.carries() {
                    continue;
                }
                let floor = floor_under(object, other);
                let own = other.base_to_own((object.position() - other.position()).xy());
                // Its middle must be over the other, or it would tip off.
                let over = other
                    .shape
                    .overlap(own, 0.0, other.shape.height())
                    .is_some();
                if over && floor < object.position().z + 0.01 {
                    support = support.max(floor);
                }
            }
            if let Some(object) = self.objects.get_mut(index) {
                object.fall_speed += GRAVITY * time_s;
                let lower = object.position().z - object.fall_speed * time_s;
                if lower <= support {
                    object.pose.translation.vector.z = support;
                    object.fall_speed = 0.0;
                } else {
                    object.pose.translation.vector.z = lower;
                }
            }
        }
    }
}

/// Height at which `object` would rest on `below`, metres.
pub(super) fn floor_under(object: &Object, below: &Object) -> f64 {
    match below.shape {
        Shape::Bowl { radius, .. } => {
            let apart = (object.position() - below.position()).xy().norm();
            if apart + object.shape.bounding_radius() < 0.95 * radius {
                below.position().z + BOWL_FLOOR_M
            } else {
                below.top()
            }
        }
        _ => below.top(),
    }
}
