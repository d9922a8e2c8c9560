//! The tabletop's physics: quasi-static contact, exact motion of the hand.
//!
//! The hand executes the action within the limits below, and the executed action is returned, so that a recorded action
//! always explains the motion. Objects follow: a finger pushes an object along the contact normal (and turns it: friction
//! with the table divides the motion between shift and turn), closing fingers hold an object rigidly, and a released
//! object falls onto the table or the object below. A rigid-body engine would add inertia and bouncing, which are hardly
//! visible at 5 Hz, and would let contacts deflect the arm from its action.

mod contact;

use nalgebra::{Isometry3, Vector3};

use crate::arm::{self, ToolPose};
use crate::gripper::{self, CONTACT_RADIUS_M, HALF_OPENING_M};
use crate::object::{Object, Shape};
use contact::floor_under;

/// Time of one action, seconds: actions come at 5 Hz.
pub const STEP_S: f64 = 0.2;
/// Contact steps per action.
const SUBSTEPS: usize = 10;
/// Share of its travel that the gripper covers in one action.
const GRIPPER_TRAVEL: f64 = 0.6;
/// Difference of heights that counts as contact, metres.
const TOUCH_M: f64 = 0.003;
/// Minimum height of the fingertips over the table, metres.
const TABLE_GAP_M: f64 = 0.003;

/// Corners of the workspace of the point between the fingertips, metres.
pub const WORKSPACE_M: [[f64; 3]; 2] = [[0.19, -0.11, 0.008], [0.35, 0.125, 0.145]];
/// Largest roll, pitch and yaw, radians.
pub const LARGEST_RPY: [f64; 3] = [0.6, 0.6, 1.3];

/// A 7-d end-effector action: dx dy dz in metres, changes of roll pitch yaw in radians, and the gripper's target, 0 closed
/// to 1 open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EndEffectorAction {
    /// Change of position, metres.
    pub translation: Vector3<f64>,
    /// Change of roll, pitch and yaw, radians.
    pub rotation: Vector3<f64>,
    /// Target of the gripper, 0 closed to 1 open.
    pub gripper: f64,
}

impl EndEffectorAction {
    /// No motion, with this gripper target, 0 closed to 1 open.
    pub fn still(gripper: f64) -> Self {
        Self {
            translation: Vector3::zeros(),
            rotation: Vector3::zeros(),
            gripper,
        }
    }

    /// Converts seven values in Bridge order.
    pub fn from_values(values: [f32; 7]) -> Self {
        let [x, y, z, roll, pitch, yaw, gripper] = values.map(f64::from);
        Self {
            translation: Vector3::new(x, y, z),
            rotation: Vector3::new(roll, pitch, yaw),
            gripper,
        }
    }

    /// The seven values in Bridge order.
    pub fn values(&self) -> [f32; 7] {
        let (t, r) = (self.translation, self.rotation);
        // Messages have single precision.
        [t.x, t.y, t.z, r.x, r.y, r.z, self.gripper].map(|v| v as f32)
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Grasp {
    object: usize,
    object_in_tool: Isometry3<f64>,
}

/// The state of the table, the objects and the hand.
#[derive(Clone, Debug, PartialEq)]
pub struct World {
    objects: Vec<Object>,
    tool: ToolPose,
    opening: f64,
    grasp: Option<Grasp>,
}

impl World {
    /// A world with the hand at `tool`, opened to `opening` (0 to 1), over `objects`.
    pub fn new(objects: Vec<Object>, tool: ToolPose, opening: f64) -> Self {
        Self {
            objects,
            tool,
            opening,
            grasp: None,
        }
    }

    /// The objects.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The pose of the tool.
    pub fn tool(&self) -> &ToolPose {
        &self.tool
    }

    /// Opening of the gripper, 0 to 1.
    pub fn opening(&self) -> f64 {
        self.opening
    }

    /// Index of the held object.
    pub fn held(&self) -> Option<usize> {
        self.grasp.as_ref().map(|grasp| grasp.object)
    }

    /// Executes `command` within the limits and returns the executed action.
    pub fn step(&mut self, command: &EndEffectorAction) -> EndEffectorAction {
        let start = self.tool;
        for _ in 0..SUBSTEPS {
            self.substep(command);
        }
        EndEffectorAction {
            translation: self.tool.position - start.position,
            rotation: self.tool.rpy - start.rpy,
            gripper: command.gripper,
        }
    }

    fn substep(&mut self, command: &EndEffectorAction) {
        let before = self.tool;
        self.move_tool(command);
        let closing = self.move_fingers(command.gripper);
        if let Some(Grasp {
            object,
            object_in_tool,
        }) = self.grasp.clone()
        {
            let pose = self.tool.frame() * object_in_tool;
            if let Some(held) = self.objects.get_mut(object) {
                held.pose = pose;
            }
            self.held_pushes_others(object);
        } else if closing {
            self.try_grasp();
        }
        let moved = (self.tool.position - before.position).xy();
        self.fingers_push(moved);
        self.objects_push_each_other();
        self.fall(STEP_S / SUBSTEPS as f64);
    }

    /// Moves the tool by one substep's share of the command, within workspace, reach and contacts.
    fn move_tool(&mut self, command: &EndEffectorAction) {
        let share = 1.0 / SUBSTEPS as f64;
        let mut next = self.tool;
        next.position += command.translation * share;
        next.rpy += command.rotation * share;
        let [low, high] = WORKSPACE_M;
        for axis in 0..3 {
            next.position[axis] = next.position[axis].clamp(low[axis], high[axis]);
            next.rpy[axis] = next.rpy[axis].clamp(-LARGEST_RPY[axis], LARGEST_RPY[axis]);
        }
        next.position.z += self.lift_needed(&next);
        if next.position.z <= high[2] + 1e-9 && arm::inverse(&next.frame()).is_some() {
            self.tool = next;
        }
    }

    /// Height by which the tool at `next` must be raised so that neither the fingers nor a held object enter the table or the
    /// top of an object.
    fn lift_needed(&self, next: &ToolPose) -> f64 {
        let (old_frame, frame) = (self.tool.frame(), next.frame());
        let mut lift = (TABLE_GAP_M - gripper::lowest(&frame, self.opening)).max(0.0);
        let held = self.held();
        let old_spheres = gripper::contact_spheres(&old_frame, self.opening);
        let spheres = gripper::contact_spheres(&frame, self.opening);
        for (index, object) in self.objects.iter().enumerate() {
            if Some(index) == held {
                continue;
            }
            let top = object.top();
            for (old, new) in old_spheres.iter().zip(&spheres) {
                let (old_bottom, bottom) = (old.z - CONTACT_RADIUS_M, new.z - CONTACT_RADIUS_M);
                if bottom < top && old_bottom > top - TOUCH_M {
                    let own = object.base_to_own(new.coords.xy() - object.position().xy());
                    // A bowl is open: only its rim stops a finger.
                    let in_bowl = matches!(object.shape, Shape::Bowl { radius, .. } if own.norm() < 0.8 * radius);
                    let level = object.shape.height();
                    if !in_bowl
                        && object
                            .shape
                            .overlap(own, 0.3 * CONTACT_RADIUS_M, level)
                            .is_some()
                    {
                        lift = lift.max(top - bottom);
                    }
                }
            }
        }
        if let Some(Grasp {
            object,
            object_in_tool,
        }) = &self.grasp
            && let Some(held) = self.objects.get(*object)
        {
            let old_bottom = held.lowest();
            let mut moved = held.clone();
            moved.pose = frame * object_in_tool;
            let bottom = moved.lowest();
            lift = lift.max(-bottom);
            for (index, other) in self.objects.iter().enumerate() {
                if index == *object {
                    continue;
                }
                let gap = (moved.position() - other.position()).xy().norm();
                let floor = floor_under(&moved, other);
                let touching =
                    gap < moved.shape.contact_radius() + other.shape.contact_radius() - 0.006;
                if touching && bottom < floor && old_bottom > floor - TOUCH_M {
                    lift = lift.max(floor - bottom);
                }
            }
        }
        lift
    }

    /// Moves the fingers one substep towards `target`; true if they close. Opening fingers release the held object.
    fn move_fingers(&mut self, target: f64) -> bool {
        let target = target.clamp(0.0, 1.0);
        let travel = GRIPPER_TRAVEL / SUBSTEPS as f64;
        if self.grasp.is_some() {
            if target <= self.opening {
                return false;
            }
            self.let_go();
        }
        let change = (target - self.opening).clamp(-travel, travel);
        self.opening += change;
        change < 0.0
    }

    fn let_go(&mut self) {
        if let Some(grasp) = self.grasp.take()
            && let Some(object) = self.objects.get_mut(grasp.object)
        {
            // It rights itself: tilts are small, and it lands within one frame.
            let (yaw, lowest) = (object.yaw(), object.lowest());
            if let Shape::Ball { radius } = object.shape {
                let centre = object.pose * nalgebra::Point3::new(0.0, 0.0, radius);
                object.pose.translation.vector.x = centre.x;
                object.pose.translation.vector.y = centre.y;
            }
            object.pose.rotation =
                nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            object.pose.translation.vector.z = lowest.max(0.0);
            object.fall_speed = 0.0;
        }
    }

    /// Grasps the object that both fingers touch.
    fn try_grasp(&mut self) {
        let frame = self.tool.frame();
        let hand = gripper::hand(&frame);
        let inner = self.opening * HALF_OPENING_M;
        for (index, object) in self.objects.iter().enumerate() {
            let tip = self.tool.position;
            let level = tip.z - object.position().z;
            if level > object.shape.height() - 0.006 || level < -0.01 {
                continue;
            }
            if matches!(object.shape, Shape::Mat { .. }) {
                continue;
            }
            let middle = object.pose * nalgebra::Point3::new(0.0, 0.0, level.max(0.0));
            let in_hand = hand.inverse() * middle;
            let opening_axis = (hand.rotation * Vector3::y()).xy();
            let own_axis = object.base_to_own(opening_axis.normalize());
            // Contact is a little above the tips.
            let half_width = object.shape.half_width(level.max(0.0) + 0.008, own_axis);
            let across = in_hand.z.abs();
            let reaches = across < 0.6 * object.shape.contact_radius().min(0.022);
            if reaches
                && half_width < HALF_OPENING_M
                && in_hand.y.abs() < half_width
                && in_hand.y.abs() + half_width < inner + 0.012
                && half_width >= inner - 1e-9
            {
                self.opening = (half_width / HALF_OPENING_M).min(1.0);
                self.grasp = Some(Grasp {
                    object: index,
                    object_in_tool: frame.inverse() * object.pose,
                });
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests;
