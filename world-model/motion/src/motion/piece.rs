//! One action with its duration, and the sum of several.

use std::sync::Arc;

use super::{Interval, rotation};
use crate::actions::ActionSpace;

/// An action with its duration.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub start_ns: i64,
    /// End: the start of the next action, or where this one is cut off.
    pub end_ns: i64,
    /// Time in which a delta is made in full \[ns\], above 0.
    pub span_ns: i64,
    pub values: Arc<[f32]>,
    /// Whether the previous action is held for lack of a new one.
    pub is_held: bool,
}

impl Piece {
    /// The same motion, held without end.
    pub fn held(&self) -> Self {
        Self {
            start_ns: self.end_ns,
            end_ns: i64::MAX,
            is_held: true,
            ..self.clone()
        }
    }

    /// Time inside an interval \[ns\].
    fn overlap_ns(&self, from_ns: i64, to_ns: i64) -> i64 {
        (self.end_ns.min(to_ns) - self.start_ns.max(from_ns)).max(0)
    }
}

/// The motion of `pieces`, in order and without overlap, from `from_ns` to `to_ns`; `None` if they start later than a
/// quarter into it.
pub(super) fn integrate(
    space: &ActionSpace,
    pieces: &[Piece],
    from_ns: i64,
    to_ns: i64,
) -> Option<Interval> {
    // Stamps jitter: a piece up to a quarter of the interval late or early belongs to it.
    let slack_ns = (to_ns - from_ns) / 4;
    // Between distant actions the robot stands still; earlier than the first its motion is unknown.
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
    // The mean of a velocity is over the whole interval, even if the action is shorter.
    let has_velocities = space.dimensions().iter().any(|d| d.kind.is_velocity());
    if let [only] = inside
        && only.overlap_ns(from_ns, to_ns) == only.span_ns
        && !(has_velocities && only.span_ns < to_ns - from_ns)
    {
        // Exactly this action, without rounding by sums.
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
        let weighted_sum = |weight: &dyn Fn(&Piece) -> f64| {
            let product =
                |piece: &Piece| Some(f64::from(*piece.values.get(index)?) * weight(piece));
            inside.iter().map(product).sum::<Option<f64>>()
        };
        values.push(if dimension.kind.is_delta() {
            weighted_sum(&share)? as f32
        } else if dimension.kind.is_velocity() {
            let overlap = |piece: &Piece| piece.overlap_ns(from_ns, to_ns) as f64;
            (weighted_sum(&overlap)? / (to_ns - from_ns).max(1) as f64) as f32
        } else {
            state.values.get(index).copied()?
        });
    }
    for first in space.rotations() {
        let mut whole = rotation::from_angles([0.0; 3]);
        for piece in inside {
            if let Some([roll, pitch, yaw]) = piece.values.get(first..first + 3) {
                // Fixed axes of the base: the later rotation multiplies from the left.
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
