//! Scales of an action space that do not suit the recorded actions.

use std::path::Path;

use wm_motion::actions::{ActionError, ActionSpace, Dimension};

use super::{Episode, statistics::DataStatistics};

/// Greatest share of clipped values.
const CLIPPED_LIMIT: f64 = 0.01;
/// Least share of the fitted range that maps to -1 to 1.
const LEAST_USE: f32 = 0.2;

/// Names the dimensions of `space` that clip many of the actions, or that leave most of -1 to 1 unused, compared with fitted
/// scales, which `fitted_file` has; `None` if all suit the actions.
///
/// Models share the published scales of Bridge V2: unused range is no fault there.
///
/// # Errors
/// Those of [`DataStatistics::of_episodes`].
pub(super) fn remark(
    space: &ActionSpace,
    episodes: &[Episode],
    fitted_file: &Path,
) -> Result<Option<String>, ActionError> {
    let fitted = DataStatistics::of_episodes(episodes.iter(), space)?.action_space;
    let is_published = space.dimensions() == ActionSpace::bridge().dimensions();
    let pairs = space.dimensions().iter().zip(fitted.dimensions());
    let faults = pairs
        .enumerate()
        .filter_map(|(index, (dimension, fitted))| {
            // Constant values and binary grippers are not fitted.
            if dimension == fitted {
                return None;
            }
            let rows = episodes.iter().flat_map(|episode| &episode.actions);
            let clipped = clipped_share(dimension, rows.filter_map(|row| row.get(index).copied()));
            let use_of = (dimension.scale / fitted.scale).abs();
            let name = &dimension.name;
            if clipped > CLIPPED_LIMIT {
                Some(format!(
                    "{name} clips {:.0} % of its values",
                    100.0 * clipped
                ))
            } else if use_of < LEAST_USE && !is_published {
                Some(format!("{name} uses {:.1} % of -1 to 1", 100.0 * use_of))
            } else {
                None
            }
        });
    let faults: Vec<String> = faults.collect();
    let text = || {
        format!(
            "the scales of the action space do not suit these actions: {}; train with the fitted ones: --action-space {}",
            faults.join(", "),
            fitted_file.display()
        )
    };
    Ok((!faults.is_empty()).then(text))
}

fn clipped_share(dimension: &Dimension, values: impl Iterator<Item = f32>) -> f64 {
    let (mut count, mut clipped) = (0_u64, 0_u64);
    for value in values {
        count += 1;
        clipped += u64::from(dimension.to_model(value).1);
    }
    clipped as f64 / count.max(1) as f64
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use wm_motion::actions::Kind;

    use super::*;

    /// The remark on values spread evenly over -1 to 1 rad/s, for a scale and a clip.
    fn of(scale: f32, clip: f32) -> Option<String> {
        let dimension = Dimension {
            name: "elbow".into(),
            unit: "rad/s".into(),
            kind: Kind::JointVelocity,
            offset: 0.0,
            scale,
            clip,
        };
        let space = ActionSpace::new("arm".into(), 10.0, vec![dimension]).unwrap();
        let values = (0..=1000).map(|index| index as f32 / 500.0 - 1.0);
        let episode = Episode {
            actions: values.map(|value| vec![value]).collect(),
            ..Episode::default()
        };
        remark(&space, &[episode], Path::new("data/action_space.json")).unwrap()
    }

    #[test]
    fn clipping_and_unused_range_are_named_with_the_option() {
        assert_eq!(of(1.0, 1.5), None);
        assert_eq!(of(0.3, 1.0), None);
        for (scale, clip, fault) in [
            (8.0, 1.0, "elbow clips 88 % of its values"),
            (0.05, 1.0, "elbow uses 4.9 % of -1 to 1"),
        ] {
            let found = of(scale, clip).unwrap();
            assert!(found.contains(fault), "{found}");
            assert!(
                found.contains("--action-space data/action_space.json"),
                "{found}"
            );
        }
    }
}
