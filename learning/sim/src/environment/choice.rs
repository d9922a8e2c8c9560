//! Draws goals that suit a table: an object, and a place for it or for the hand.
//!
//! A drawn goal seems possible; the solution decides.

use nalgebra::Vector3;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;

use super::goal::{GoalKind, Target};
use crate::object::{Object, Shape};
use crate::teleop::{DIRECTIONS, Relation, Task, is_burdened, is_graspable, is_inside};
use crate::variety::Span;
use crate::world::{WORKSPACE_M, World};

/// Minimum distance of the tool from the goal of a reach, metres.
const LEAST_REACH_M: f64 = 0.06;
/// Height of that goal over the top of an object, metres, as for operators.
const HOVER_M: Span = Span::new(0.03, 0.08);
/// Distance of a push, metres.
const PUSH_M: Span = Span::new(0.05, 0.10);
/// Deviation of a push from left, right, forward and away, radians, as for operators.
const PUSH_ANGLE_RAD: Span = Span::around_zero(0.35);
/// Minimum distance of a carried object, metres.
const LEAST_CARRY_M: f64 = 0.08;
/// Gap between an object and its neighbour at the goal, metres: a finger opens there.
const BESIDE_M: Span = Span::new(0.045, 0.06);
/// Minimum gap between the goal of an object and other objects, metres.
const CLEAR_M: f64 = 0.015;
/// Minimum distance of goals from the edge of the workspace, metres.
const EDGE_M: f64 = 0.015;

/// Draws a goal and its task in words, for a viewer along `viewer` (unit vectors to the right and ahead over the table);
/// `None` if the draw does not suit.
pub fn draw(
    kind: GoalKind,
    world: &World,
    viewer: [Vector3<f64>; 2],
    rng: &mut ChaCha8Rng,
) -> Option<(Target, Task)> {
    let indices: Vec<usize> = (0..world.objects().len()).collect();
    let index = *indices.choose(rng)?;
    match kind {
        GoalKind::Reach => reach(world, index, rng),
        GoalKind::Push => push(world, index, viewer, rng),
        GoalKind::PickPlace => {
            let other = *indices.choose(rng)?;
            pick_place(world, [index, other], viewer, rng)
        }
    }
}

fn reach(world: &World, index: usize, rng: &mut ChaCha8Rng) -> Option<(Target, Task)> {
    let object = world.objects().get(index)?;
    let up = object.shape.height() + HOVER_M.pick(rng);
    let position = object.position() + Vector3::z() * up;
    let suits = is_inside(position, 0.0)
        && position.z < WORKSPACE_M[1][2]
        && (position - world.tool().position).norm() >= LEAST_REACH_M;
    let task = Task::Reach { object: index };
    suits.then_some((Target::Tool { position }, task))
}

fn push(
    world: &World,
    index: usize,
    viewer: [Vector3<f64>; 2],
    rng: &mut ChaCha8Rng,
) -> Option<(Target, Task)> {
    let object = world.objects().get(index)?;
    let (words, [right, ahead]) = *DIRECTIONS.choose(rng)?;
    let towards = viewer[0] * right + viewer[1] * ahead;
    let (sin, cos) = PUSH_ANGLE_RAD.pick(rng).sin_cos();
    let direction = Vector3::new(
        cos * towards.x - sin * towards.y,
        sin * towards.x + cos * towards.y,
        0.0,
    );
    let from = object.position();
    let place = from + direction * PUSH_M.pick(rng);
    let suits = !matches!(object.shape, Shape::Mat { .. })
        && is_inside(place, EDGE_M)
        && is_clear(world, object, index, place);
    let target = Target::Object {
        object: index,
        place,
        carried: false,
    };
    let task = Task::Push {
        object: index,
        direction_words: words,
        direction: towards,
        viewer,
        from,
    };
    suits.then_some((target, task))
}

fn pick_place(
    world: &World,
    [index, other_index]: [usize; 2],
    viewer: [Vector3<f64>; 2],
    rng: &mut ChaCha8Rng,
) -> Option<(Target, Task)> {
    let object = world.objects().get(index)?;
    let other = world.objects().get(other_index)?;
    let relation = if matches!(other.shape, Shape::Mat { .. }) {
        Relation::OnMat
    } else {
        *[
            Relation::Left,
            Relation::Right,
            Relation::Front,
            Relation::Behind,
        ]
        .choose(rng)?
    };
    let [right, ahead] = relation.direction();
    let apart = object.shape.bounding_radius() + other.shape.bounding_radius() + BESIDE_M.pick(rng);
    let place = other.position()
        + (viewer[0] * right + viewer[1] * ahead) * apart
        + Vector3::z() * relation.rise(other);
    let suits = index != other_index
        && is_graspable(object)
        && !is_burdened(world, index)
        && is_inside(place, EDGE_M)
        && is_clear(world, object, index, place)
        && (place - object.position()).norm() >= LEAST_CARRY_M;
    let target = Target::Object {
        object: index,
        place,
        carried: true,
    };
    let task = Task::Place {
        object: index,
        other: other_index,
        relation,
        viewer,
        spot: place,
    };
    suits.then_some((target, task))
}

/// Whether `object` touches nothing but mats at `place`.
fn is_clear(world: &World, object: &Object, index: usize, place: Vector3<f64>) -> bool {
    world.objects().iter().enumerate().all(|(i, other)| {
        i == index
            || matches!(other.shape, Shape::Mat { .. })
            || (other.position() - place).xy().norm()
                > object.shape.bounding_radius() + other.shape.bounding_radius() + CLEAR_M
    })
}
