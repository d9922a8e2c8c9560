//! The values that a search chooses, and their limits.

use serde::{Deserialize, Serialize};

use crate::{PlanError, Workspace};

/// The searched values of each model action, and their limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawSpace")]
pub struct SearchSpace {
    /// A model action (A) with the values of unsearched coordinates.
    base: Vec<f32>,
    coordinates: Vec<Coordinate>,
    /// Searched values of the action before the plan, from which rate limits hold.
    previous: Option<Vec<f32>>,
    workspace: Option<Workspace>,
}

/// The serialised form, unchecked.
#[derive(Deserialize)]
struct RawSpace {
    base: Vec<f32>,
    coordinates: Vec<Coordinate>,
    previous: Option<Vec<f32>>,
    workspace: Option<Workspace>,
}

impl TryFrom<RawSpace> for SearchSpace {
    type Error = PlanError;

    fn try_from(parts: RawSpace) -> Result<Self, PlanError> {
        let mut space = Self::new(parts.base, parts.coordinates)?;
        if let Some(workspace) = parts.workspace {
            space = space.within(workspace)?;
        }
        if let Some(previous) = &parts.previous
            && previous.len() != space.len()
        {
            return Err(PlanError::Setting(format!(
                "{} values before the plan, expected {}",
                previous.len(),
                space.len()
            )));
        }
        Ok(Self {
            previous: parts.previous,
            ..space
        })
    }
}

/// A searched value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coordinate {
    /// Index in a model action.
    pub index: usize,
    /// Possible values.
    pub range: Range,
    /// Greatest change per step \[model units\]; infinite for no limit.
    pub rate: f32,
}

/// Possible values of a coordinate, in model units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Range {
    /// All values from the first to the second.
    Between(f32, f32),
    /// One of two values, such as a closed or open gripper.
    Either(f32, f32),
}

impl Range {
    /// Least and greatest value.
    pub fn bounds(self) -> (f32, f32) {
        match self {
            Self::Between(low, high) | Self::Either(low, high) => (low, high),
        }
    }

    fn nearest(self, value: f32) -> f32 {
        match self {
            Self::Between(low, high) => value.clamp(low, high),
            Self::Either(low, high) => {
                if value > (low + high) / 2.0 {
                    high
                } else {
                    low
                }
            }
        }
    }
}

impl SearchSpace {
    /// A space of `coordinates`; all other values of a model action come from `base` (A).
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid part.
    pub fn new(base: Vec<f32>, coordinates: Vec<Coordinate>) -> Result<Self, PlanError> {
        let complain = |text: String| Err(PlanError::Setting(text));
        if coordinates.is_empty() {
            return complain("no bounds: nothing to search over".into());
        }
        for (place, coordinate) in coordinates.iter().enumerate() {
            let Coordinate { index, range, rate } = *coordinate;
            let (low, high) = range.bounds();
            if !(low.is_finite() && high.is_finite() && low <= high) {
                return complain(format!(
                    "bounds {low}..{high} of value {index} must be finite and ascending"
                ));
            }
            if index >= base.len() {
                return complain(format!(
                    "value {index} is searched, but the model's actions have {} values",
                    base.len()
                ));
            }
            if coordinates.iter().take(place).any(|c| c.index == index) {
                return complain(format!("value {index} is searched twice"));
            }
            if rate.is_nan() || rate <= 0.0 {
                return complain(format!(
                    "the rate limit of value {index} must be positive, not {rate}"
                ));
            }
        }
        Ok(Self {
            base,
            coordinates,
            previous: None,
            workspace: None,
        })
    }

    /// Searches the first values of model actions of `action_dim` values, each within its bounds; the rest are zero.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid part.
    pub fn bounded(bounds: &[(f32, f32)], action_dim: usize) -> Result<Self, PlanError> {
        let coordinates = bounds.iter().enumerate().map(|(index, (low, high))| {
            let range = Range::Between(*low, *high);
            Coordinate {
                index,
                range,
                rate: f32::INFINITY,
            }
        });
        Self::new(vec![0.0; action_dim], coordinates.collect())
    }

    /// Sets the `action` (A) before the plan, from which rate limits hold.
    ///
    /// # Errors
    /// [`PlanError::Setting`] if its length does not fit.
    pub fn after(self, action: &[f32]) -> Result<Self, PlanError> {
        let of = |c: &Coordinate| action.get(c.index).copied();
        let Some(previous) = self.coordinates.iter().map(of).collect::<Option<Vec<_>>>() else {
            return Err(PlanError::Setting(format!(
                "the action before the plan has {} values, expected {}",
                action.len(),
                self.base.len()
            )));
        };
        Ok(Self {
            previous: Some(previous),
            ..self
        })
    }

    /// Limits motion to a workspace.
    ///
    /// # Errors
    /// [`PlanError::Setting`] if an axis has no searched value, or a number is not finite.
    pub fn within(self, workspace: Workspace) -> Result<Self, PlanError> {
        for axis in &workspace.axes {
            let (low, high) = axis.range;
            let is_finite = [axis.metres, axis.position, low, high]
                .iter()
                .all(|value| value.is_finite());
            if axis.coordinate >= self.len() || !is_finite || low > high {
                return Err(PlanError::Setting(format!(
                    "workspace axis {axis:?}: expected a searched value below {}, finite numbers and an ascending range",
                    self.len()
                )));
            }
        }
        Ok(Self {
            workspace: Some(workspace),
            ..self
        })
    }

    /// Number of searched values.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.coordinates.len()
    }

    /// Length A of a model action.
    pub fn action_dim(&self) -> usize {
        self.base.len()
    }

    /// The searched values.
    pub fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    /// Searched values of the action before the plan, if known.
    pub fn previous(&self) -> Option<&[f32]> {
        self.previous.as_deref()
    }

    /// Limits of the end effector's position.
    pub fn workspace(&self) -> Option<&Workspace> {
        self.workspace.as_ref()
    }

    /// The model action (A) with these searched values.
    pub fn whole(&self, action: &[f32]) -> Vec<f32> {
        let mut whole = self.base.clone();
        for (coordinate, value) in self.coordinates.iter().zip(action) {
            if let Some(place) = whole.get_mut(coordinate.index) {
                *place = *value;
            }
        }
        whole
    }

    /// The searched values of a model action; 0 (no motion) for those beyond a shorter one, as of an inverse dynamics
    /// model.
    pub fn searched(&self, whole: &[f32]) -> Vec<f32> {
        let of = |c: &Coordinate| whole.get(c.index).copied().unwrap_or_default();
        self.coordinates.iter().map(of).collect()
    }

    /// The plan (steps x values) nearest to `flat` within all limits. Bounds are applied first, then rates, then the
    /// workspace, which wins.
    pub(crate) fn limit(&self, mut flat: Vec<f32>) -> Vec<f32> {
        let mut before = self.previous.clone();
        let mut positions: Vec<f64> = match &self.workspace {
            Some(workspace) => workspace.axes.iter().map(|axis| axis.position).collect(),
            None => Vec::new(),
        };
        for action in flat.chunks_exact_mut(self.coordinates.len()) {
            for (place, coordinate) in self.coordinates.iter().enumerate() {
                let Some(value) = action.get_mut(place) else {
                    continue;
                };
                *value = coordinate.range.nearest(*value);
                let last = before.as_ref().and_then(|before| before.get(place));
                if let (Range::Between(low, high), Some(last)) = (coordinate.range, last) {
                    // The earlier action may lie outside the bounds, which win.
                    let (least, most) = (last - coordinate.rate, last + coordinate.rate);
                    *value = value.clamp(least, most).clamp(low, high);
                }
            }
            if let Some(workspace) = &self.workspace {
                for (axis, position) in workspace.axes.iter().zip(&mut positions) {
                    if let Some(value) = action.get_mut(axis.coordinate) {
                        (*value, *position) = axis.keep(*position, *value);
                    }
                }
            }
            before = Some(action.to_vec());
        }
        flat
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::WorkspaceAxis;

    fn between(index: usize, rate: f32) -> Coordinate {
        let range = Range::Between(-1.0, 1.0);
        Coordinate { index, range, rate }
    }

    #[test]
    fn unsearched_values_stay() {
        let space = SearchSpace::new(vec![7.0, 8.0, 9.0], vec![between(1, 1.0)]).unwrap();
        assert_eq!(space.whole(&[0.5]), [7.0, 0.5, 9.0]);
        assert_eq!(space.searched(&[1.0, 2.0, 3.0]), [2.0]);
    }

    #[test]
    fn gripper_is_one_of_two_values() {
        let gripper = Coordinate {
            index: 0,
            range: Range::Either(-1.0, 1.0),
            rate: 0.1,
        };
        let space = SearchSpace::new(vec![0.0], vec![gripper]).unwrap();
        assert_eq!(space.limit(vec![0.2, -3.0, 0.0]), [1.0, -1.0, -1.0]);
    }

    #[test]
    fn workspace_blocks_leaving_and_allows_returning() {
        let axis = WorkspaceAxis {
            coordinate: 0,
            metres: 0.1,
            position: 0.25,
            range: (0.0, 0.3),
        };
        let space = |position| {
            let axes = vec![WorkspaceAxis { position, ..axis }];
            let space = SearchSpace::new(vec![0.0], vec![between(0, f32::INFINITY)]).unwrap();
            space.within(Workspace { axes }).unwrap()
        };
        let kept = space(0.25).limit(vec![1.0, 1.0, -1.0]);
        assert!((kept[0] - 0.5).abs() < 1e-6 && kept[1].abs() < 1e-6 && kept[2] == -1.0);
        let back = space(0.4).limit(vec![1.0, -0.5]);
        assert_eq!(back, [0.0, -0.5]);
    }

    #[test]
    fn invalid_parts_are_named() {
        let refused = |coordinates| SearchSpace::new(vec![0.0; 2], coordinates).unwrap_err();
        assert!(refused(vec![]).to_string().contains("nothing to search"));
        let far = refused(vec![between(2, 1.0)]).to_string();
        assert!(far.contains("value 2"), "{far}");
        assert!(
            refused(vec![between(1, 1.0); 2])
                .to_string()
                .contains("twice")
        );
        assert!(
            refused(vec![between(1, f32::NAN)])
                .to_string()
                .contains("rate")
        );
        let range = Range::Between(1.0, -1.0);
        let inverted = refused(vec![Coordinate {
            range,
            ..between(0, 1.0)
        }])
        .to_string();
        assert!(inverted.contains("1..-1"), "{inverted}");
    }

    proptest! {
        #[test]
        fn every_limit_holds(
            flat in prop::collection::vec(-9.0_f32..9.0, 12),
            previous in prop::collection::vec(-1.0_f32..1.0, 2),
            position in 0.0_f64..0.3,
        ) {
            let axes = vec![WorkspaceAxis { coordinate: 1, metres: 0.05, position, range: (0.0, 0.3) }];
            let space = SearchSpace::new(vec![0.0; 2], vec![between(0, 0.3), between(1, f32::INFINITY)])
                .unwrap()
                .after(&previous)
                .unwrap()
                .within(Workspace { axes })
                .unwrap();
            let kept = space.limit(flat);
            let (mut before, mut place) = (previous[0], position);
            for action in kept.chunks_exact(2) {
                prop_assert!(action.iter().all(|value| (-1.0..=1.0).contains(value)));
                prop_assert!((action[0] - before).abs() <= 0.3 + 1e-6);
                before = action[0];
                place += f64::from(action[1]) * 0.05;
                prop_assert!((-1e-6..=0.3 + 1e-6).contains(&place));
            }
            for (again, once) in space.limit(kept.clone()).iter().zip(&kept) {
                prop_assert!((again - once).abs() < 1e-5);
            }
        }
    }
}
