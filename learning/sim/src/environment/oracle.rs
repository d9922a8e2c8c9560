//! A controller that sees the true state: what to do next follows from how things stand now.
//!
//! It keeps no memory. A world that was disturbed is one more state to go on from.

use nalgebra::{Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;

use super::goal::Target;
use crate::arm::ToolPose;
use crate::gripper::{self, CONTACT_RADIUS_M, HALF_OPENING_M};
use crate::object::{Object, Shape};
use crate::teleop::{CLEAR_M, grasp_level, graspable, inside, turn_towards};
use crate::world::{EndEffectorAction, World};

/// Top speed, metres an action: an operator's.
const SPEED_M: f64 = 0.04;
/// Speed of a push, metres an action: slower, so that it can be steered.
const PUSH_SPEED_M: f64 = 0.025;
/// Nearer to where it goes than this, the tool is there, metres.
const THERE_M: f64 = 0.004;
/// So far beside the point below it the hand may go down to it, metres: the grasp allows 10 mm.
const BESIDE_M: f64 = 0.008;
/// And so far it may be while it is down there already, metres.
const BESIDE_BELOW_M: f64 = 0.014;
/// Turned by less than this away from how it should be, the hand is held right, radians.
const TURNED_RAD: f64 = 0.15;
/// What is carried has its foot over all else that stands on the table, metres.
const CARRIED_M: f64 = 0.075;
/// An object whose foot is nearer to the table than this is let go of, metres.
const RELEASE_M: f64 = 0.005;
/// Height of the tool over an object's foot as it pushes, metres: low enough for a cone and a ball.
const PUSH_LEVEL_M: f64 = 0.014;
/// Reach of the closed hand from its middle towards any of its four sides, metres.
const HAND_M: f64 = 0.010 + CONTACT_RADIUS_M;
/// Room between the hand and the object that it comes down behind, metres.
const GAP_M: f64 = 0.012;
/// Farther beside the line of a push than this share of its way to the object's middle, the hand would slip
/// off.
const OFF_LINE: f64 = 0.4;
/// A push ends this near to its place, metres.
const PUSHED_M: f64 = 0.010;
/// Room that the open fingers should have beside other objects, metres.
const FINGER_ROOM_M: f64 = 0.006;
/// Widest half of an object that the fingers close on, metres.
const WIDEST_M: f64 = 0.92 * HALF_OPENING_M;
/// Farthest turn of a grasp, radians.
const LARGEST_YAW_RAD: f64 = 1.25;

/// The next command towards `target`, or `None` when there is nothing more to do.
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

/// What leaves everything as it is: no motion, and the gripper stays shut or open.
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
    // Over what stands in between, and down in the end.
    let over = offset.xy().norm() > SPEED_M;
    let mut aim = position;
    if over {
        aim.z = aim.z.max(CLEAR_M);
    }
    Some(go(world, aim, tool.rpy, at_rest(world).gripper))
}

/// Lets go of what the hand holds where that is low enough, and brings it down before.
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
    go(world, aim, straight(tool.rpy.z), 0.0)
}

/// Grasps the object, carries it over the place, puts it down and leaves it.
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
        return Some(go(world, tool.position + way, straight(tool.rpy.z), 0.0));
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
        && (tool.rpy - straight(yaw)).amax() < TURNED_RAD;
    // Fingers that have closed further than the object is wide have missed it.
    let width = across(object, yaw) / HALF_OPENING_M;
    if at && world.opening() > width - 0.02 {
        return Some(go(world, point, straight(yaw), 0.0));
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
    // At any turn that suits: the closed hand is about square.
    let room = finger_room(world, index, (point, push_yaw(direction, 0.0)), 0.0);
    if graspable(object) && (room < 0.0 || !inside(point, 0.0)) {
        // The hand cannot get behind it.
        return carry(world, target, index, object, place);
    }
    Some(descend(world, point, push_yaw(direction, tool.rpy.z), 0.0))
}

/// The way to `point` with the hand upright, turned by `yaw` and opened to `gripper`: up, across at a clear
/// height, and down when the hand is over it and ready.
fn descend(world: &World, point: Vector3<f64>, yaw: f64, gripper: f64) -> EndEffectorAction {
    let tool = world.tool();
    let rpy = straight(yaw);
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

/// Whether what is `height` metres up can go down, that far beside the point below.
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

fn straight(yaw: f64) -> Vector3<f64> {
    Vector3::new(0.0, 0.0, yaw)
}

/// The turn at which one of the closed hand's flat sides meets what is pushed along `direction`: of those,
/// the one next to the present turn.
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
fn across(object: &Object, yaw: f64) -> f64 {
    let own = object.base_to_own(Vector2::new(yaw.cos(), yaw.sin()));
    object.shape.half_width(grasp_level(object) + 0.008, own)
}

/// The turn of a grasp: fingers on two sides of a box, anywhere around all else, where they do not meet
/// other objects, now or at `place`.
fn grasp_yaw(world: &World, index: usize, object: &Object, place: Vector3<f64>) -> f64 {
    let yaws: Vec<f64> = if let Shape::Box { .. } = object.shape {
        // The hand opens along the base's x at zero yaw; the long sides lie across a box's y,
        // and come last.
        [0.0, FRAC_PI_2]
            .map(|side| {
                let yaw = object.yaw() + side;
                yaw - (yaw / std::f64::consts::PI).round() * std::f64::consts::PI
            })
            .into_iter()
            .filter(|yaw| yaw.abs() <= LARGEST_YAW_RAD && across(object, *yaw) < WIDEST_M)
            .collect()
    } else {
        vec![-1.2, 1.2, -0.8, 0.8, -0.4, 0.4, 0.0]
    };
    let room = |yaw: f64| {
        let at = |position| finger_room(world, index, (position, yaw), 1.0);
        at(object.position()).min(at(place))
    };
    // All that have enough are as good as each other. Of equals the last counts: the most usual one.
    let enough = |yaw: f64| room(yaw).min(FINGER_ROOM_M);
    let best = yaws
        .into_iter()
        .max_by(|a, b| enough(*a).total_cmp(&enough(*b)));
    best.unwrap_or(0.0)
}

/// Least gap between the fingers at a position and a turn, opened to `opening`, and the objects but `index`,
/// metres.
fn finger_room(
    world: &World,
    index: usize,
    (position, yaw): (Vector3<f64>, f64),
    opening: f64,
) -> f64 {
    let tool = ToolPose {
        position,
        rpy: straight(yaw),
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
