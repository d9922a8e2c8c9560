//! Plans the sub-goals of a task.

use nalgebra::Vector3;
use rand::Rng;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;

use super::task::{Relation, Task};
use crate::object::{Object, Shape};
use crate::world::{WORKSPACE_M, World};

/// The destination of a move.
#[derive(Clone, Debug)]
pub enum Aim {
    /// In the base frame, metres.
    Point(Vector3<f64>),
    /// An offset from the present foot of an object.
    Object {
        index: usize,
        /// Offset, metres.
        offset: Vector3<f64>,
    },
}

/// A sub-goal.
#[derive(Clone, Debug)]
pub enum Move {
    /// Move the tool to a pose.
    Go {
        aim: Aim,
        /// Roll, pitch and yaw, radians.
        rpy: Vector3<f64>,
        /// Gripper on the way, 0 closed to 1 open.
        gripper: f64,
        /// Tolerance, metres.
        tolerance_m: f64,
        /// Whether the hand may make gestures on the way.
        loose: bool,
    },
    /// Move the gripper in place.
    Grip {
        /// 0 closed to 1 open.
        to: f64,
        frames: usize,
    },
    /// Stay near this place and turn the hand.
    Linger { frames: usize },
    /// Move freely.
    Drift { frames: usize },
}

/// Directions of pushes: in words, and as components to the viewer's right and away from the viewer.
pub const DIRECTIONS: [(&str, [f64; 2]); 4] = [
    ("to the left", [-1.0, 0.0]),
    ("to the right", [1.0, 0.0]),
    ("forward", [0.0, -1.0]),
    ("away", [0.0, 1.0]),
];

/// Tolerances of a passing point, and of a point where contact matters, metres.
const ROUGH_M: f64 = 0.02;
const FINE_M: f64 = 0.008;

/// Chooses a task that suits the scene, and its moves.
pub fn next(
    rng: &mut ChaCha8Rng,
    world: &World,
    viewer: [Vector3<f64>; 2],
    first: bool,
) -> (Task, Vec<Move>) {
    // If the scene does not allow the chosen task, choose another.
    for _ in 0..8 {
        let choice = rng.random_range(0.0..1.0);
        let found = if first && choice < 0.55 {
            // Few pairs and places are suitable.
            (0..4).find_map(|_| place(rng, world, viewer))
        } else if choice < if first { 0.75 } else { 0.6 } {
            pick_up(rng, world)
        } else if choice < 0.9 {
            push(rng, world, viewer)
        } else {
            reach(rng, world)
        };
        if let Some(found) = found {
            return found;
        }
    }
    (Task::Explore, vec![Move::Drift { frames: 12 }])
}

/// The moves that put down the held object, if any.
pub fn put_down(world: &World) -> Option<Vec<Move>> {
    let object = world.objects().get(world.held()?)?;
    let tool = world.tool();
    let straight = Vector3::new(0.0, 0.0, tool.rpy.z);
    let low = tool.position - Vector3::z() * object.lowest();
    let point = |above: f64| Aim::Point(low + Vector3::z() * above);
    Some(vec![
        go(point(0.004), straight, 0.0, FINE_M),
        Move::Grip { to: 1.0, frames: 2 },
        go(point(0.08), straight, 1.0, ROUGH_M),
    ])
}

fn draw_object(rng: &mut ChaCha8Rng, world: &World) -> Option<usize> {
    (!world.objects().is_empty()).then(|| rng.random_range(0..world.objects().len()))
}

fn draw_other(rng: &mut ChaCha8Rng, world: &World, index: usize) -> Option<usize> {
    let others = world.objects().len().checked_sub(1).filter(|n| *n > 0)?;
    let other = rng.random_range(0..others);
    Some(if other < index { other } else { other + 1 })
}

/// A turn of the hand for moves where it does not matter.
pub fn draw_loose_rpy(rng: &mut ChaCha8Rng, yaw: f64) -> Vector3<f64> {
    let tilt = |rng: &mut ChaCha8Rng| {
        if rng.random_bool(0.8) {
            rng.random_range(-0.5..0.5)
        } else {
            0.0
        }
    };
    let yaw = (yaw + rng.random_range(-0.7..0.7)).clamp(-1.2, 1.2);
    Vector3::new(tilt(rng), tilt(rng), yaw)
}

fn go(aim: Aim, rpy: Vector3<f64>, gripper: f64, tolerance_m: f64) -> Move {
    Move::Go {
        aim,
        rpy,
        gripper,
        tolerance_m,
        loose: false,
    }
}

/// A move during which the hand may turn and, while empty, open and close.
pub fn go_with_gestures(aim: Aim, rpy: Vector3<f64>, gripper: f64) -> Move {
    Move::Go {
        aim,
        rpy,
        gripper,
        tolerance_m: ROUGH_M,
        loose: true,
    }
}

pub fn is_graspable(object: &Object) -> bool {
    !matches!(object.shape, Shape::Bowl { .. } | Shape::Mat { .. })
}

/// Whether `object` supports or contains another.
pub fn is_burdened(world: &World, index: usize) -> bool {
    let Some(base) = world.objects().get(index) else {
        return false;
    };
    world.objects().iter().enumerate().any(|(other, object)| {
        other != index
            && object.position().z > base.position().z + 0.004
            && (object.position() - base.position()).xy().norm() < base.shape.bounding_radius()
    })
}

/// Height of the grasp over an object's foot, metres.
pub fn grasp_level(object: &Object) -> f64 {
    match object.shape {
        Shape::Ball { radius } => 0.85 * radius,
        // Low on a cone, near its wide foot.
        Shape::Cone { .. } => 0.012,
        _ => (0.4 * object.shape.height()).clamp(0.012, 0.026),
    }
}

/// The moves that grasp an object, and the yaw of the grasp.
fn grasp(rng: &mut ChaCha8Rng, index: usize, object: &Object) -> (Vec<Move>, f64) {
    let yaw = match object.shape {
        Shape::Box { .. } => {
            // Fingers on the long sides, across the box's x; half a turn is the same grasp.
            let across = object.yaw() - std::f64::consts::FRAC_PI_2;
            let turns = (across / std::f64::consts::PI).round();
            (across - turns * std::f64::consts::PI).clamp(-1.25, 1.25)
        }
        _ => rng.random_range(-0.9..0.9),
    };
    // People aim well, but not always.
    let miss = if rng.random_bool(0.1) { 0.02 } else { 0.003 };
    let mut offset = Vector3::new(
        rng.random_range(-miss..miss),
        rng.random_range(-miss..miss),
        0.0,
    );
    offset.z = object.shape.height() + rng.random_range(0.03..0.06);
    let straight = Vector3::new(
        rng.random_range(-0.12..0.12),
        rng.random_range(-0.12..0.12),
        yaw,
    );
    let above = Aim::Object { index, offset };
    let mut high = offset;
    high.z += rng.random_range(0.02..0.05);
    let approach = Aim::Object {
        index,
        offset: high,
    };
    offset.z = grasp_level(object);
    let at = Aim::Object { index, offset };
    let moves = vec![
        go_with_gestures(approach, draw_loose_rpy(rng, yaw), 1.0),
        go(above, straight, 1.0, 0.015),
        go(at, straight, 1.0, FINE_M),
        Move::Grip { to: 0.0, frames: 3 },
    ];
    (moves, yaw)
}

fn pick_up(rng: &mut ChaCha8Rng, world: &World) -> Option<(Task, Vec<Move>)> {
    let index = draw_object(rng, world)?;
    let object = world.objects().get(index)?;
    if !is_graspable(object) || is_burdened(world, index) {
        return None;
    }
    let (mut moves, yaw) = grasp(rng, index, object);
    let lift = object.position() + Vector3::z() * rng.random_range(0.08..0.13);
    moves.push(go_with_gestures(
        Aim::Point(lift),
        draw_loose_rpy(rng, yaw),
        0.0,
    ));
    // Carry it a little, so that data have held objects moving in every direction.
    for _ in 0..rng.random_range(0..=3) {
        let [low, high] = WORKSPACE_M;
        let mut point = Vector3::from_fn(|axis, _| rng.random_range(low[axis]..high[axis]));
        point.z = point.z.max(0.06);
        moves.push(go_with_gestures(
            Aim::Point(point),
            draw_loose_rpy(rng, yaw),
            0.0,
        ));
    }
    Some((Task::PickUp { object: index }, moves))
}

fn place(
    rng: &mut ChaCha8Rng,
    world: &World,
    viewer: [Vector3<f64>; 2],
) -> Option<(Task, Vec<Move>)> {
    let index = draw_object(rng, world)?;
    let other_index = draw_other(rng, world, index)?;
    let (object, other) = (
        world.objects().get(index)?,
        world.objects().get(other_index)?,
    );
    if !is_graspable(object) || is_burdened(world, index) {
        return None;
    }
    let relation = match other.shape {
        Shape::Bowl { .. } => Relation::In,
        Shape::Mat { .. } => Relation::OnMat,
        _ => *[
            Relation::Left,
            Relation::Right,
            Relation::Front,
            Relation::Behind,
            Relation::On,
        ]
        .choose(rng)?,
    };
    // Room for a finger that opens between the two.
    let apart = object.shape.bounding_radius()
        + other.shape.bounding_radius()
        + rng.random_range(0.04..0.055);
    let [right, ahead] = relation.direction();
    let base = Vector3::new(other.position().x, other.position().y, 0.0);
    let spot = base
        + (viewer[0] * right + viewer[1] * ahead) * apart
        + Vector3::z() * relation.rise(other);
    let fits = match relation {
        Relation::On => {
            other.shape.carries()
                && !is_burdened(world, other_index)
                && !matches!(object.shape, Shape::Ball { .. })
        }
        Relation::In => match other.shape {
            Shape::Bowl { radius, .. } => {
                object.shape.bounding_radius() < 0.65 * radius && !is_burdened(world, other_index)
            }
            _ => false,
        },
        _ => world.objects().iter().enumerate().all(|(i, third)| {
            i == index
                || i == other_index && relation == Relation::OnMat
                || (third.position() - spot).xy().norm()
                    > object.shape.bounding_radius() + third.shape.bounding_radius() + 0.01
        }),
    };
    if !fits || !is_inside(spot, 0.015) {
        return None;
    }
    let (mut moves, yaw) = grasp(rng, index, object);
    // Above a bowl's rim, since opening fingers inside would push it away.
    let release = match relation {
        Relation::In => (grasp_level(object) + 0.004).max(other.shape.height() + 0.006),
        _ => grasp_level(object) + 0.004,
    };
    let height = rng.random_range(0.06..0.10) + spot.z;
    let placing = Vector3::new(0.0, 0.0, yaw);
    let lift = object.position() + Vector3::z() * height;
    moves.push(go_with_gestures(
        Aim::Point(lift),
        draw_loose_rpy(rng, yaw),
        0.0,
    ));
    moves.push(go(
        Aim::Point(spot + Vector3::z() * height),
        placing,
        0.0,
        0.015,
    ));
    moves.push(go(
        Aim::Point(spot + Vector3::z() * release),
        placing,
        0.0,
        FINE_M,
    ));
    moves.push(Move::Grip { to: 1.0, frames: 2 });
    let retreat = spot + Vector3::z() * (height + 0.04);
    moves.push(go_with_gestures(
        Aim::Point(retreat),
        draw_loose_rpy(rng, yaw),
        1.0,
    ));
    let task = Task::Place {
        object: index,
        other: other_index,
        relation,
        viewer,
        spot,
    };
    Some((task, moves))
}

fn push(
    rng: &mut ChaCha8Rng,
    world: &World,
    viewer: [Vector3<f64>; 2],
) -> Option<(Task, Vec<Move>)> {
    let index = draw_object(rng, world)?;
    let object = world.objects().get(index)?;
    let (words, [right, ahead]) = *DIRECTIONS.choose(rng)?;
    let towards = viewer[0] * right + viewer[1] * ahead;
    // Pushes deviate a little.
    let (sin, cos) = rng.random_range(-0.35..0.35_f64).sin_cos();
    let direction = Vector3::new(
        cos * towards.x - sin * towards.y,
        sin * towards.x + cos * towards.y,
        0.0,
    );
    let from = object.position();
    let reach = object.shape.bounding_radius() + 0.035;
    let level = Vector3::z() * rng.random_range(0.010..0.018);
    let start = from - direction * reach;
    let end = from + direction * (rng.random_range(0.04..0.12) - object.shape.bounding_radius());
    if from.z > 0.003
        || matches!(object.shape, Shape::Mat { .. })
        || !is_inside(start, 0.0)
        || !is_inside(end, -0.01)
    {
        return None;
    }
    let rpy = Vector3::new(
        rng.random_range(-0.25..0.25),
        rng.random_range(-0.25..0.25),
        rng.random_range(-1.1..1.1),
    );
    // Mostly a closed hand; an open one pushes with both fingers or encloses a small object.
    let gripper = if rng.random_bool(0.8) { 0.0 } else { 1.0 };
    let hover = Vector3::z() * rng.random_range(0.05..0.08);
    let moves = vec![
        go_with_gestures(Aim::Point(start + hover), rpy, gripper),
        go(Aim::Point(start + level), rpy, gripper, 0.01),
        go(Aim::Point(end + level), rpy, gripper, 0.01),
        go_with_gestures(Aim::Point(end + hover), draw_loose_rpy(rng, rpy.z), gripper),
    ];
    let task = Task::Push {
        object: index,
        direction_words: words,
        direction: towards,
        viewer,
        from,
    };
    Some((task, moves))
}

fn reach(rng: &mut ChaCha8Rng, world: &World) -> Option<(Task, Vec<Move>)> {
    let index = draw_object(rng, world)?;
    let object = world.objects().get(index)?;
    let offset = Vector3::z() * (object.shape.height() + rng.random_range(0.02..0.08));
    let yaw = rng.random_range(-1.1..1.1);
    let gripper = f64::from(u8::from(rng.random_bool(0.5)));
    let rpy = draw_loose_rpy(rng, yaw);
    let moves = vec![
        go_with_gestures(Aim::Object { index, offset }, rpy, gripper),
        Move::Grip {
            to: 1.0 - gripper,
            frames: rng.random_range(2..=4),
        },
        Move::Linger {
            frames: rng.random_range(4..=10),
        },
    ];
    Some((Task::Reach { object: index }, moves))
}

/// Whether a spot on the table is inside the workspace by `margin` metres.
pub fn is_inside(spot: Vector3<f64>, margin: f64) -> bool {
    let [low, high] = WORKSPACE_M;
    (0..2).all(|axis| spot[axis] > low[axis] + margin && spot[axis] < high[axis] - margin)
}
