//! One action over its time, and what several of them come to.

use std::sync::Arc;

use super::{Interval, rotation};
use crate::actions::ActionSpace;

/// An action over the time that it takes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub start_ns: i64,
    /// Where it ends: at the next one, or where it is cut off.
    pub end_ns: i64,
    /// The time in which a delta is made in full \[ns\], above 0.
    pub span_ns: i64,
    pub values: Arc<[f32]>,
    /// Whether nobody said so: the piece before goes on.
    pub is_held: bool,
}

impl Piece {
    /// The same motion, going on without end.
    pub fn held(&self) -> Self {
        Self {
            start_ns: self.end_ns,
            end_ns: i64::MAX,
            is_held: true,
            ..self.clone()
        }
    }

    /// The time of it that lies in an interval \[ns\].
    fn overlap_ns(&self, from_ns: i64, to_ns: i64) -> i64 {
        (self.end_ns.min(to_ns) - self.start_ns.max(from_ns)).max(0)
    }
}

/// What `pieces`, which are in order and do not overlap, come to from `from_ns` to `to_ns`; none where they begin later
/// than a quarter into it.
pub(super) fn integrate(
    space: &ActionSpace,
    pieces: &[Piece],
    from_ns: i64,
    to_ns: i64,
) -> Option<Interval> {
    // Stamps jitter: what begins a quarter of the interval late or early still belongs to it.
    let slack_ns = (to_ns - from_ns) / 4;
    // Between two actions that are far apart the robot stands still; before the first one nothing is known.
    if pieces.first()?.start_ns > from_ns + slack_ns {
        return None;
    }
    let begin = pieces.partition_point(|piece| piece.end_ns <= from_ns);
    let end = pieces.partition_point(|piece| piece.start_ns < to_ns);
    let inside = pieces.get(begin..end)?;
    let held_ns: i64 = inside
        .iter()
        .filter(|piece| piece.is_held)
        .map(|piece| piece.overlap_ns(from_ns, to_ns))
        .sum();
    let is_given = held_ns <= slack_ns;
    // The mean of a velocity is over all of the interval, also if the action is shorter.
    let has_velocities = space.dimensions().iter().any(|d| d.kind.is_velocity());
    if let [only] = inside
        && only.overlap_ns(from_ns, to_ns) == only.span_ns
        && !(has_velocities && only.span_ns < to_ns - from_ns)
    {
        // Exactly this action: without the rounding of sums.
        let values = only.values.to_vec();
        return Some(Interval { values, is_given });
    }
    Some(Interval {
        values: sum(space, pieces, inside, from_ns, to_ns)?,
        is_given,
    })
}

fn sum(
    space: &ActionSpace,
    pieces: &[Piece],
    inside: &[Piece],
    from_ns: i64,
    to_ns: i64,
) -> Option<Vec<f32>> {
    let share = |piece: &Piece| piece.overlap_ns(from_ns, to_ns) as f64 / piece.span_ns as f64;
    let state_ns = to_ns - (to_ns - from_ns) / 4;
    let begun = pieces.partition_point(|piece| piece.start_ns <= state_ns);
    let state = pieces.get(begun.saturating_sub(1))?;
    let mut values = Vec::with_capacity(space.len());
    for (index, dimension) in space.dimensions().iter().enumerate() {
        values.push(if dimension.kind.is_delta() {
            let part = |piece: &Piece| {
                let value = piece.values.get(index).copied().unwrap_or_default();
                f64::from(value) * share(piece)
            };
            inside.iter().map(part).sum::<f64>() as f32
        } else if dimension.kind.is_velocity() {
            let way = |piece: &Piece| {
                let value = piece.values.get(index).copied().unwrap_or_default();
                f64::from(value) * piece.overlap_ns(from_ns, to_ns) as f64
            };
            (inside.iter().map(way).sum::<f64>() / (to_ns - from_ns).max(1) as f64) as f32
        } else {
            state.values.get(index).copied()?
        });
    }
    for first in space.rotations() {
        let mut whole = rotation::from_angles([0.0; 3]);
        for piece in inside {
            if let Some([roll, pitch, yaw]) = piece.values.get(first..first + 3) {
                // About the fixed axes of the base: the later one goes on the left.
                whole = rotation::share([*roll, *pitch, *yaw], share(piece)) * whole;
            }
        }
        for (value, angle) in values
            .iter_mut()
            .skip(first)
            .zip(rotation::to_angles(&whole))
        {
            *value = angle;
        }
    }
    Some(values)
}
