//! What a search may choose.

use serde::{Deserialize, Serialize};

use crate::{PlanError, Workspace};

/// What a search may choose: some values of each model action, and the limits that hold for them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Parts")]
pub struct SearchSpace {
    /// A model action (A); what is not searched is as in it.
    base: Vec<f32>,
    coordinates: Vec<Coordinate>,
    /// The searched values of the action before the plan; rate limits hold from it on.
    previous: Option<Vec<f32>>,
    workspace: Option<Workspace>,
}

/// What others send.
#[derive(Deserialize)]
struct Parts {
    base: Vec<f32>,
    coordinates: Vec<Coordinate>,
    previous: Option<Vec<f32>>,
    workspace: Option<Workspace>,
}

impl TryFrom<Parts> for SearchSpace {
    type Error = PlanError;

    fn try_from(parts: Parts) -> Result<Self, PlanError> {
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
    /// Its place in a model action.
    pub index: usize,
    /// What it may be.
    pub range: Range,
    /// Greatest change from one step to the next \[model units\]; infinite for none.
    pub rate: f32,
}

/// What a searched value may be, in model units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Range {
    /// Anything from the first to the second.
    Between(f32, f32),
    /// One of two, such as a gripper that is closed or open.
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
    /// A space of `coordinates`; the other values of a model action are those of `base` (A).
    ///
    /// # Errors
    /// [`PlanError::Setting`] names what cannot serve.
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

    /// A space of the first values of a model action of `action_dim` values, each between its bounds; the rest are zero.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names what cannot serve.
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

    /// The same after an `action` (A), which rate limits hold from.
    ///
    /// # Errors
    /// [`PlanError::Setting`] where its length does not fit.
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

    /// The same within a workspace.
    ///
    /// # Errors
    /// [`PlanError::Setting`] where an axis names no searched value, or a number is not finite.
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

    /// Searched values of an action.
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

    /// The searched values of the action before the plan, where it is known.
    pub fn previous(&self) -> Option<&[f32]> {
        self.previous.as_deref()
    }

    /// Where the end effector may be.
    pub fn workspace(&self) -> Option<&Workspace> {
        self.workspace.as_ref()
    }

    /// The model action (A) of searched values.
    pub fn whole(&self, action: &[f32]) -> Vec<f32> {
        let mut whole = self.base.clone();
        for (coordinate, value) in self.coordinates.iter().zip(action) {
            if let Some(place) = whole.get_mut(coordinate.index) {
                *place = *value;
            }
        }
        whole
    }

    /// The searched values of a model action; zeros for those that it has not.
    pub fn searched(&self, whole: &[f32]) -> Vec<f32> {
        let of = |c: &Coordinate| whole.get(c.index).copied().unwrap_or_default();
        self.coordinates.iter().map(of).collect()
    }

    /// The plan of steps x values nearest to `flat` that keeps all limits: bounds first, then rates, then the workspace,
    /// which wins.
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
                    // What came before may lie outside the bounds, which win.
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
    fn what_is_not_searched_stays_as_it_is() {
        let space = SearchSpace::new(vec![7.0, 8.0, 9.0], vec![between(1, 1.0)]).unwrap();
        assert_eq!(space.whole(&[0.5]), [7.0, 0.5, 9.0]);
        assert_eq!(space.searched(&[1.0, 2.0, 3.0]), [2.0]);
    }

    #[test]
    fn a_gripper_is_one_of_two() {
        let gripper = Coordinate {
            index: 0,
            range: Range::Either(-1.0, 1.0),
            rate: 0.1,
        };
        let space = SearchSpace::new(vec![0.0], vec![gripper]).unwrap();
        assert_eq!(space.limit(vec![0.2, -3.0, 0.0]), [1.0, -1.0, -1.0]);
    }

    #[test]
    fn nothing_moves_out_of_the_workspace_and_what_is_outside_may_come_back() {
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
    fn what_cannot_serve_is_named() {
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
