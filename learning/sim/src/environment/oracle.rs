//! A controller that knows the true state and chooses its next action from it alone.
//!
//! It has no memory, so it continues from any disturbed state.

use nalgebra::{Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;

use super::goal::Target;
use crate::arm::ToolPose;
use crate::gripper::{self, CONTACT_RADIUS_M, HALF_OPENING_M};
use crate::object::{Object, Shape};
use crate::teleop::{CLEAR_M, grasp_level, is_graspable, is_inside, turn_towards};
use crate::world::{EndEffectorAction, World};

/// Top speed, metres per action, as an operator's.
const SPEED_M: f64 = 0.04;
/// Speed of a push, metres per action: slow enough to steer.
const PUSH_SPEED_M: f64 = 0.025;
/// Tolerance of the tool at an aim, metres.
const THERE_M: f64 = 0.004;
/// Horizontal deviation at which the hand may go down, metres: the grasp allows 10 mm.
const BESIDE_M: f64 = 0.008;
/// Horizontal deviation at which a low hand stays down, metres.
const BESIDE_BELOW_M: f64 = 0.014;
/// Tolerance of the hand's turn, radians.
const TURNED_RAD: f64 = 0.15;
/// Height of a carried object's foot, above all standing objects, metres.
const CARRIED_M: f64 = 0.075;
/// Height of an object's foot at which it is released, metres.
const RELEASE_M: f64 = 0.005;
/// Height of a pushing tool over an object's foot, metres: low enough for cones and balls.
const PUSH_LEVEL_M: f64 = 0.014;
/// Half width of the closed hand, metres.
const HAND_M: f64 = 0.010 + CONTACT_RADIUS_M;
/// Gap between the hand and the object behind which it goes down, metres.
const GAP_M: f64 = 0.012;
/// Deviation from the line of a push at which the hand would slip off, as a share of its distance to the object's middle.
const OFF_LINE: f64 = 0.4;
/// Tolerance of a push, metres.
const PUSHED_M: f64 = 0.010;
/// Gap between open fingers and other objects, metres.
const FINGER_ROOM_M: f64 = 0.006;
/// Largest half width of a is_graspable object, metres.
const WIDEST_M: f64 = 0.92 * HALF_OPENING_M;
/// Largest turn of a grasp, radians.
const LARGEST_YAW_RAD: f64 = 1.25;

/// The next command towards `target`, or `None` when it is attained.
pub fn command(target: &Target, world: &World) -> Option<EndEffectorAction> {
    match *target {
        Target::Tool { position } => reach(world, position),
        Target::Object {
            object,
            place,
            carried,
        } => {
            let index = object;
            if world.held().is_some_and(|held| held != index) {
                return Some(put_down(world));
            }
            let object = world.objects().get(index)?;
            if carried {
                carry(world, target, index, object, place)
            } else {
                push(world, target, index, object, place)
            }
        }
    }
}

/// The action without effect: no motion, and the gripper stays closed or open.
pub fn at_rest(world: &World) -> EndEffectorAction {
    let open = world.held().is_none() && world.opening() > 0.5;
    EndEffectorAction::still(f64::from(u8::from(open)))
}

fn reach(world: &World, position: Vector3<f64>) -> Option<EndEffectorAction> {
    let tool = world.tool();
    let offset = position - tool.position;
    if offset.norm() < THERE_M {
        return None;
    }
    // Over the objects in between, then down.
    let over = offset.xy().norm() > SPEED_M;
    let mut aim = position;
    if over {
        aim.z = aim.z.max(CLEAR_M);
    }
    Some(go(world, aim, tool.rpy, at_rest(world).gripper))
}

/// Lowers and releases the held object.
fn put_down(world: &World) -> EndEffectorAction {
    let lowest = world
        .held()
        .and_then(|held| world.objects().get(held))
        .map_or(0.0, Object::lowest);
    if lowest < RELEASE_M {
        return EndEffectorAction::still(1.0);
    }
    let tool = world.tool();
    let aim = tool.position - Vector3::z() * lowest;
    go(world, aim, upright_rpy(tool.rpy.z), 0.0)
}

/// Grasps the object, carries it over the place, puts it down and moves away.
fn carry(
    world: &World,
    target: &Target,
    index: usize,
    object: &Object,
    place: Vector3<f64>,
) -> Option<EndEffectorAction> {
    let tool = world.tool();
    if world.held() == Some(index) {
        let offset = place - object.position();
        let lowest = object.lowest() - place.z;
        let over = is_over(offset, lowest);
        if over && lowest < RELEASE_M {
            return Some(EndEffectorAction::still(1.0));
        }
        let rise = Vector3::z() * (CARRIED_M - lowest);
        let way = if over {
            Vector3::new(offset.x, offset.y, -lowest)
        } else if rise.z > 0.3 * CARRIED_M {
            rise
        } else {
            Vector3::new(offset.x, offset.y, rise.z)
        };
        return Some(go(world, tool.position + way, upright_rpy(tool.rpy.z), 0.0));
    }
    if target.met_by(world) {
        return leave(world);
    }
    let level = grasp_level(object);
    let point = object.position() + Vector3::z() * level;
    let yaw = grasp_yaw(world, index, object, place);
    let offset = point - tool.position;
    let at = offset.xy().norm() < BESIDE_M
        && offset.z.abs() < 0.01
        && (tool.rpy - upright_rpy(yaw)).amax() < TURNED_RAD;
    // Fingers that closed further than the object's width have missed it.
    let width = half_width_across(object, yaw) / HALF_OPENING_M;
    if at && world.opening() > width - 0.02 {
        return Some(go(world, point, upright_rpy(yaw), 0.0));
    }
    Some(descend(world, point, yaw, 1.0))
}

/// Opens the hand and raises it clear of everything.
fn leave(world: &World) -> Option<EndEffectorAction> {
    let tool = world.tool();
    if world.opening() < 0.95 {
        return Some(EndEffectorAction::still(1.0));
    }
    let aim = Vector3::new(tool.position.x, tool.position.y, CLEAR_M);
    (tool.position.z < CLEAR_M - THERE_M).then(|| go(world, aim, tool.rpy, 1.0))
}

/// Comes down behind the object with a closed hand and pushes it straight to the place.
fn push(
    world: &World,
    target: &Target,
    index: usize,
    object: &Object,
    place: Vector3<f64>,
) -> Option<EndEffectorAction> {
    if world.held() == Some(index) {
        return carry(world, target, index, object, place);
    }
    let missing = (place - object.position()).xy();
    if missing.norm() < PUSHED_M {
        return None;
    }
    let tool = world.tool();
    let direction = missing.normalize();
    let from_object = (tool.position - object.position()).xy();
    let behind = -from_object.dot(&direction);
    let beside = from_object + direction * behind;
    let own = object.base_to_own(direction);
    let apart = object.shape.half_width(PUSH_LEVEL_M, own) + HAND_M;
    let low = tool.position.z < object.position().z + 2.0 * PUSH_LEVEL_M;
    let in_line = behind > 0.0 && behind < apart + 2.0 * GAP_M && beside.norm() < OFF_LINE * behind;
    if low && in_line && world.opening() < 0.1 {
        let advance = (behind - apart + missing.norm()).clamp(0.0, PUSH_SPEED_M);
        let way = direction * advance - beside;
        let aim = Vector3::new(
            tool.position.x + way.x,
            tool.position.y + way.y,
            object.position().z + PUSH_LEVEL_M,
        );
        return Some(go(world, aim, tool.rpy, 0.0));
    }
    if target.met_by(world) {
        return None;
    }
    let start = object.position().xy() - direction * (apart + GAP_M);
    let point = Vector3::new(start.x, start.y, object.position().z + PUSH_LEVEL_M);
    // At any suitable turn: the closed hand is about square.
    let room = finger_room(world, index, (point, push_yaw(direction, 0.0)), 0.0);
    if is_graspable(object) && (room < 0.0 || !is_inside(point, 0.0)) {
        // The hand cannot reach the place behind it.
        return carry(world, target, index, object, place);
    }
    Some(descend(world, point, push_yaw(direction, tool.rpy.z), 0.0))
}

/// Moves to `point` with an upright hand at `yaw` and opening `gripper`: up, across at a clear height, and down when the
/// hand is over the point and ready.
fn descend(world: &World, point: Vector3<f64>, yaw: f64, gripper: f64) -> EndEffectorAction {
    let tool = world.tool();
    let rpy = upright_rpy(yaw);
    let offset = point - tool.position;
    let ready = is_over(offset, -offset.z)
        && (tool.rpy - rpy).amax() < TURNED_RAD
        && (world.opening() - gripper).abs() < 0.05;
    let aim = if ready {
        point
    } else if tool.position.z < CLEAR_M - 0.01 {
        Vector3::new(tool.position.x, tool.position.y, CLEAR_M)
    } else {
        Vector3::new(point.x, point.y, CLEAR_M)
    };
    go(world, aim, rpy, gripper)
}

/// Whether the hand at `height` metres may go down at this horizontal deviation.
fn is_over(offset: Vector3<f64>, height: f64) -> bool {
    let limit = if height < 0.5 * CARRIED_M {
        BESIDE_BELOW_M
    } else {
        BESIDE_M
    };
    offset.xy().norm() < limit
}

/// One action towards a pose.
fn go(world: &World, aim: Vector3<f64>, rpy: Vector3<f64>, gripper: f64) -> EndEffectorAction {
    EndEffectorAction {
        translation: (aim - world.tool().position).cap_magnitude(SPEED_M),
        rotation: turn_towards(rpy, world),
        gripper,
    }
}

fn upright_rpy(yaw: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, yaw)
}

/// The turn at which a flat side of the closed hand meets an object pushed along `direction`, nearest to the present turn.
fn push_yaw(direction: Vector2<f64>, present: f64) -> f64 {
    let angle = direction.y.atan2(direction.x);
    let quarters = ((present - angle) / FRAC_PI_2).round();
    let yaw = angle + quarters * FRAC_PI_2;
    if yaw > LARGEST_YAW_RAD {
        yaw - FRAC_PI_2
    } else if yaw < -LARGEST_YAW_RAD {
        yaw + FRAC_PI_2
    } else {
        yaw
    }
}

/// Half of the object's width between fingers turned by `yaw`, metres.
fn half_width_across(object: &Object, yaw: f64) -> f64 {
    let own = object.base_to_own(Vector2::new(yaw.cos(), yaw.sin()));
    object.shape.half_width(grasp_level(object) + 0.008, own)
}

/// The turn of a grasp: fingers on two sides of a box, at any angle around other shapes, without contact to other objects,
/// now and at `place`.
fn grasp_yaw(world: &World, index: usize, object: &Object, place: Vector3<f64>) -> f64 {
    let yaws: Vec<f64> = if let Shape::Box { .. } = object.shape {
        // At zero yaw, the hand opens along the base's x; a box's long sides lie across its y and
        [0.0, FRAC_PI_2]
            .map(|side| {
                let yaw = object.yaw() + side;
                yaw - (yaw / std::f64::consts::PI).round() * std::f64::consts::PI
            })
            .into_iter()
            .filter(|yaw| {
                yaw.abs() <= LARGEST_YAW_RAD && half_width_across(object, *yaw) < WIDEST_M
            })
            .collect()
    } else {
        vec![-1.2, 1.2, -0.8, 0.8, -0.4, 0.4, 0.0]
    };
    let room = |yaw: f64| {
        let at = |position| finger_room(world, index, (position, yaw), 1.0);
        at(object.position()).min(at(place))
    };
    // All turns with enough room are equal; the last one, which is the most usual, wins.
    let enough = |yaw: f64| room(yaw).min(FINGER_ROOM_M);
    let best = yaws
        .into_iter()
        .max_by(|a, b| enough(*a).total_cmp(&enough(*b)));
    // There is always a candidate turn.
    best.unwrap_or(0.0)
}

/// Smallest gap between the fingers, at a position, turn and `opening`, and the objects except `index`, metres.
fn finger_room(
    world: &World,
    index: usize,
    (position, yaw): (Vector3<f64>, f64),
    opening: f64,
) -> f64 {
    let tool = ToolPose {
        position,
        rpy: upright_rpy(yaw),
    };
    let spheres = gripper::contact_spheres(&tool.frame(), opening);
    let others = world.objects().iter().enumerate();
    others
        .filter(|(other, object)| *other != index && !matches!(object.shape, Shape::Mat { .. }))
        .flat_map(|(_, object)| {
            spheres.iter().map(|sphere| {
                (sphere.coords - object.position()).xy().norm()
                    - object.shape.bounding_radius()
                    - CONTACT_RADIUS_M
            })
        })
        .fold(f64::INFINITY, f64::min)
}
