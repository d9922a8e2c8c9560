//! Failures of tasks: a working plan is changed as a person would fail.
//!
//! The world decides whether the task fails: a planned miss may hit.

use nalgebra::Vector3;
use rand::Rng;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;

use super::plan::{
    Aim, DIRECTIONS, Move, draw_loose_rpy, go_with_gestures, is_graspable, is_inside,
};
use super::task::Task;
use crate::object::Shape;
use crate::world::World;

/// The kind of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Failure {
    /// The fingers close beside the object or above it.
    MissedGrasp,
    /// The object falls out of the hand on the way.
    Dropped,
    /// It is put down, or pushed, to another place.
    WrongPlace,
    /// The hand takes another object than the instruction names.
    WrongObject,
    /// The operator stops halfway.
    Halted,
}

impl Failure {
    /// All kinds.
    pub const ALL: [Self; 5] = [
        Self::MissedGrasp,
        Self::Dropped,
        Self::WrongPlace,
        Self::WrongObject,
        Self::Halted,
    ];

    /// Changes `task` and its moves to this failure; `None` if it does not apply.
    pub(super) fn spoil(
        self,
        rng: &mut ChaCha8Rng,
        world: &World,
        task: Task,
        mut moves: Vec<Move>,
    ) -> Option<(Task, Vec<Move>)> {
        match self {
            Self::MissedGrasp => miss_grasp(rng, &task, &mut moves)?,
            Self::Dropped => drop_object(rng, world, &task, &mut moves)?,
            Self::WrongPlace => return use_wrong_place(rng, task, moves),
            Self::WrongObject => return Some((name_other_object(rng, world, task)?, moves)),
            Self::Halted => {
                let end = match task {
                    Task::PickUp { .. } => find_grasp(&task, &moves)?,
                    Task::Place { .. } => moves
                        .iter()
                        .rposition(|step| matches!(step, Move::Grip { to, .. } if *to > 0.5))?,
                    // Before the push itself.
                    Task::Push { .. } => 2.min(moves.len()),
                    Task::Explore | Task::Reach { .. } => return None,
                };
                moves.truncate(rng.random_range(1..=end.max(1)));
            }
        }
        Some((task, moves))
    }
}

/// Index of the move that closes the fingers on the object.
fn find_grasp(task: &Task, moves: &[Move]) -> Option<usize> {
    matches!(task, Task::PickUp { .. } | Task::Place { .. })
        .then(|| {
            moves
                .iter()
                .position(|step| matches!(step, Move::Grip { to, .. } if *to < 0.5))
        })
        .flatten()
}

fn miss_grasp(rng: &mut ChaCha8Rng, task: &Task, moves: &mut [Move]) -> Option<()> {
    let grasp = find_grasp(task, moves)?;
    let aside = if rng.random_bool(0.35) {
        Vector3::z() * rng.random_range(0.04..0.06)
    } else {
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
        Vector3::new(cos, sin, 0.0) * rng.random_range(0.045..0.07)
    };
    for step in moves.iter_mut().take(grasp) {
        if let Move::Go {
            aim: Aim::Object { offset, .. },
            ..
        } = step
        {
            *offset += aside;
        }
    }
    Some(())
}

fn drop_object(
    rng: &mut ChaCha8Rng,
    world: &World,
    task: &Task,
    moves: &mut Vec<Move>,
) -> Option<()> {
    let grasp = find_grasp(task, moves)?;
    let from = world.objects().get(task.object()?)?.position();
    // On the way to the place, or after any move that carries it.
    let (keep, over) = match task {
        Task::Place { spot, .. } => (
            grasp + 2,
            from + (spot - from) * rng.random_range(0.1..0.55),
        ),
        _ => {
            let carried = moves.len().checked_sub(grasp + 1).filter(|n| *n > 0)?;
            (grasp + 1 + rng.random_range(1..=carried), from)
        }
    };
    moves.truncate(keep);
    if let Task::Place { .. } = task {
        let at = Vector3::new(over.x, over.y, rng.random_range(0.06..0.10));
        moves.push(go_with_gestures(
            Aim::Point(at),
            draw_loose_rpy(rng, 0.0),
            0.0,
        ));
    }
    moves.push(Move::Grip {
        to: 1.0,
        frames: rng.random_range(2..=4),
    });
    Some(())
}

fn use_wrong_place(
    rng: &mut ChaCha8Rng,
    mut task: Task,
    mut moves: Vec<Move>,
) -> Option<(Task, Vec<Move>)> {
    if let Task::Push {
        direction_words,
        direction,
        viewer,
        ..
    } = &mut task
    {
        let others: Vec<_> = DIRECTIONS
            .iter()
            .filter(|(words, _)| words != direction_words)
            .collect();
        let (words, [right, ahead]) = others.choose(rng)?;
        *direction_words = words;
        *direction = viewer[0] * *right + viewer[1] * *ahead;
        return Some((task, moves));
    }
    let grasp = find_grasp(&task, &moves)?;
    let Task::Place { spot, .. } = &task else {
        return None;
    };
    let aside = (0..12).find_map(|_| {
        let (sin, cos) = rng.random_range(0.0..std::f64::consts::TAU).sin_cos();
        let aside = Vector3::new(cos, sin, 0.0) * rng.random_range(0.07..0.12);
        is_inside(spot + aside, 0.01).then_some(aside)
    })?;
    // All moves after grasp and lift.
    for step in moves.iter_mut().skip(grasp + 2) {
        if let Move::Go {
            aim: Aim::Point(point),
            ..
        } = step
        {
            *point += aside;
        }
    }
    Some((task, moves))
}

/// The task with another object in the instruction than in the moves.
fn name_other_object(rng: &mut ChaCha8Rng, world: &World, mut task: Task) -> Option<Task> {
    let present = task.object()?;
    let place = match &task {
        Task::Place { other, .. } => Some(*other),
        _ => None,
    };
    let others: Vec<usize> = world
        .objects()
        .iter()
        .enumerate()
        .filter(|(index, object)| {
            let suits = match task {
                Task::Reach { .. } => true,
                Task::Push { .. } => !matches!(object.shape, Shape::Mat { .. }),
                _ => is_graspable(object),
            };
            suits && *index != present && Some(*index) != place
        })
        .map(|(index, _)| index)
        .collect();
    let named = *others.choose(rng)?;
    let position = world.objects().get(named)?.position();
    match &mut task {
        Task::Explore => return None,
        Task::Reach { object } | Task::PickUp { object } | Task::Place { object, .. } => {
            *object = named;
        }
        Task::Push { object, from, .. } => {
            *object = named;
            *from = position;
        }
    }
    Some(task)
}
