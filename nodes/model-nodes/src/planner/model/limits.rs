//! From limits in metres and radians to limits of model actions.

use wm_motion::actions::{Accumulation, ActionEncoding, Kind};
use wm_planner::{Coordinate, Range, Workspace, WorkspaceAxis};

use super::PlannerError;
use crate::planner::{MotionLimits, WorkspaceBox};

/// The values of a model action that are searched: the dimensions named by `searched`, or all but grippers where none is
/// named.
///
/// # Errors
/// [`PlannerError::Searched`] names a dimension that the model's actions do not have.
pub(super) fn coordinates(
    encoding: &ActionEncoding,
    searched: &[String],
    limits: &MotionLimits,
) -> Result<Vec<Coordinate>, PlannerError> {
    let space = encoding.space();
    if let Some(unknown) = searched
        .iter()
        .find(|name| space.dimensions().iter().all(|known| known.name != **name))
    {
        return Err(PlannerError::Searched {
            name: unknown.clone(),
            space: space.to_string(),
        });
    }
    let mut coordinates = Vec::new();
    for (index, (dimension, (low, high))) in
        space.dimensions().iter().zip(encoding.bounds()).enumerate()
    {
        let is_searched = match searched {
            [] => !dimension.kind.is_gripper(),
            named => named.contains(&dimension.name),
        };
        let (most, change) = match dimension.kind {
            Kind::TranslationDelta => (limits.translation, limits.translation_change),
            Kind::RotationDelta => (limits.rotation, limits.rotation_change),
            _ => (None, None),
        };
        let in_model_units = |limit: Option<f64>| match limit {
            Some(limit) => (limit / intervals(encoding)) as f32 * dimension.scale.abs(),
            None => f32::INFINITY,
        };
        let most = in_model_units(most);
        let range = match dimension.kind {
            Kind::GripperBinary => Range::Either(-1.0, 1.0),
            _ => Range::Between(low.max(-most), high.min(most)),
        };
        if is_searched {
            coordinates.push(Coordinate {
                index,
                range,
                rate: in_model_units(change),
            });
        }
    }
    Ok(coordinates)
}

/// The box for an end effector at `position` \[m\]: an axis for each translation that is searched.
pub(super) fn workspace(
    encoding: &ActionEncoding,
    coordinates: &[Coordinate],
    limits: &WorkspaceBox,
    position: [f64; 3],
) -> Workspace {
    let dimensions = encoding.space().dimensions();
    let translations = dimensions
        .iter()
        .enumerate()
        .filter(|(_, dimension)| dimension.kind == Kind::TranslationDelta);
    let sides = limits.min.into_iter().zip(limits.max).zip(position);
    let mut axes = Vec::new();
    for ((index, dimension), (range, position)) in translations.zip(sides) {
        let Some(coordinate) = coordinates.iter().position(|c| c.index == index) else {
            continue;
        };
        axes.push(WorkspaceAxis {
            coordinate,
            metres: intervals(encoding) / f64::from(dimension.scale),
            position,
            range,
        });
    }
    Workspace { axes }
}

/// How often a model step repeats its scaled delta: but for the sum, in each of its intervals.
fn intervals(encoding: &ActionEncoding) -> f64 {
    match encoding.accumulation() {
        Accumulation::Sum => 1.0,
        // A few.
        _ => encoding.frame_skip() as f64,
    }
}
