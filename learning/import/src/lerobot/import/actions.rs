//! Meaning and mapping of a data set's action values.

use crate::{ActionForm, ActionMapping, remedy::ValueSource};
use wm_motion::actions::{ActionError, ActionSpace, Kind};

use super::derived::DerivedSpace;
use crate::lerobot::{
    LeRobotError,
    dataset::{Dataset, Rows},
    info::ACTION,
};

/// Number of values in Bridge V2's actions.
const BRIDGE: usize = 7;

/// The action values of a data set.
#[derive(Debug)]
pub(super) struct Actions {
    /// The bags' action space, if known.
    pub space: Option<ActionSpace>,
    /// The space with its reasons, if it was derived from the data set.
    pub derived: Option<DerivedSpace>,
    /// Why no space describes the values, if none does.
    pub unfit: Option<ActionError>,
    /// The column of each value of the space, if the order differs.
    order: Option<Vec<usize>>,
    mapping: ActionMapping,
    period_s: f64,
}

impl Actions {
    /// The actions of a data set, with the user's action space, if given; else Bridge V2's if the names are its names;
    /// else one that is derived from names and values.
    ///
    /// # Errors
    /// The space does not fit the data set, or the mapping does not apply.
    pub fn of(
        dataset: &Dataset,
        given: Option<&ActionSpace>,
        mapping: ActionMapping,
        rows: &mut Rows,
    ) -> Result<Option<Self>, LeRobotError> {
        let Some(feature) = dataset.info.features.get(ACTION) else {
            return Ok(None);
        };
        let names = feature.value_names();
        let is_hand = mapping.form != ActionForm::Delta
            || mapping.translation_scale != 1.0
            || mapping.rotation_scale != 1.0;
        let known = match given {
            Some(space) => Some((space.clone(), find_order(space, &names)?)),
            None => recognise_space(&names, is_hand),
        };
        let derived = match known {
            None if !is_hand => DerivedSpace::of(dataset, mapping, rows),
            _ => Ok(None),
        };
        let (derived, unfit) = match derived {
            Ok(derived) => (derived, None),
            Err(error) => (None, Some(error)),
        };
        let (space, order) = known.map_or((None, None), |(space, order)| (Some(space), order));
        let space = space.or_else(|| derived.as_ref().map(|derived| derived.space.clone()));
        let is_bridge = |space: &ActionSpace| {
            let kinds: Vec<Kind> = space.dimensions().iter().map(|d| d.kind).collect();
            let bridge = ActionSpace::bridge();
            let hand = bridge.dimensions().iter().take(BRIDGE - 1);
            kinds.len() == BRIDGE
                && hand.zip(&kinds).all(|(bridge, kind)| bridge.kind == *kind)
                && kinds.last().is_some_and(|kind| kind.is_gripper())
        };
        let refused = |text: String| Err(ActionError::Space(text).into());
        if is_hand && !space.as_ref().is_some_and(is_bridge) {
            return refused(format!(
                "--actions, --translation-scale and --rotation-scale map to the seven values of Bridge V2; describe {} with \
                 --action-space FILE",
                names.join(" ")
            ));
        }
        let has_gripper =
            |space: &ActionSpace| space.dimensions().iter().any(|d| d.kind.is_gripper());
        if mapping.gripper.is_some() && !space.as_ref().is_some_and(has_gripper) {
            return refused(format!(
                "--gripper-range needs a gripper: describe {} with --action-space FILE",
                names.join(" ")
            ));
        }
        Ok(Some(Self {
            space,
            derived,
            unfit,
            order,
            mapping,
            period_s: dataset.info.fps.recip(),
        }))
    }

    /// Origin of the bags' values.
    pub fn source(&self) -> ValueSource {
        ValueSource {
            gripper: self.mapping.gripper,
            is_of_states: false,
        }
    }

    /// Maps actions of the data set, (T, values), in place.
    pub fn map(&self, actions: &mut [Vec<f32>]) {
        if let Some(order) = &self.order {
            for action in actions.iter_mut() {
                let ordered = order.iter().filter_map(|at| action.get(*at).copied());
                *action = ordered.collect();
            }
        }
        let Some(space) = &self.space else { return };
        let seven: Option<Vec<[f32; BRIDGE]>> = actions
            .iter()
            .map(|action| <[f32; BRIDGE]>::try_from(action.as_slice()).ok())
            .collect();
        let is_delta = self.mapping.form == ActionForm::Delta
            && self.mapping.translation_scale == 1.0
            && self.mapping.rotation_scale == 1.0;
        match seven {
            Some(mut rows) if !is_delta => {
                self.mapping.apply(&mut rows, &[], self.period_s);
                for (action, row) in actions.iter_mut().zip(rows) {
                    action.clear();
                    action.extend(row);
                }
            }
            _ => {
                for action in actions.iter_mut() {
                    self.mapping.map_grippers(space, action);
                }
            }
        }
    }
}

/// Bridge V2's space if the names are its names, in any order, or if the values are mapped to it, with the column of each
/// dimension.
fn recognise_space(names: &[String], is_mapped: bool) -> Option<(ActionSpace, Option<Vec<usize>>)> {
    let bridge = ActionSpace::bridge();
    match match_names(&bridge, names) {
        Some(order) => Some((bridge, order)),
        None if is_mapped && names.len() == BRIDGE => Some((bridge, None)),
        None => None,
    }
}

/// The column of each dimension if all columns are named; `Some(None)` if the order is the same.
fn match_names(space: &ActionSpace, names: &[String]) -> Option<Option<Vec<usize>>> {
    let dimensions = space.dimensions().iter();
    let columns = dimensions.map(|dimension| names.iter().position(|name| *name == dimension.name));
    let columns: Vec<usize> = columns.collect::<Option<_>>()?;
    if columns.len() != names.len() {
        return None;
    }
    let is_same = columns
        .iter()
        .enumerate()
        .all(|(index, column)| index == *column);
    Some((!is_same).then_some(columns))
}

/// The column of each dimension of a space: by name, or by position if no name is known.
fn find_order(space: &ActionSpace, names: &[String]) -> Result<Option<Vec<usize>>, LeRobotError> {
    let mismatch = || ActionError::Mismatch {
        expected: format!("the action space given is {space}"),
        actual: format!("the dataset has {}", names.join(" ")),
    };
    if space.len() != names.len() {
        return Err(mismatch().into());
    }
    if let Some(order) = match_names(space, names) {
        return Ok(order);
    }
    // With some known names at other positions, the meaning is uncertain.
    let mut dimensions = space.dimensions().iter().enumerate();
    let is_elsewhere = |(index, dimension): (usize, &wm_motion::actions::Dimension)| {
        let column = names.iter().position(|name| *name == dimension.name);
        column.is_some_and(|column| column != index)
    };
    match dimensions.any(is_elsewhere) {
        true => Err(mismatch().into()),
        false => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<String> {
        text.split(' ').map(str::to_owned).collect()
    }

    #[test]
    fn values_are_found_by_name_in_any_order() {
        let bridge = ActionSpace::bridge();
        let of = |text: &str| find_order(&bridge, &names(text));
        assert_eq!(of("dx dy dz droll dpitch dyaw gripper").unwrap(), None);
        let first = of("gripper dx dy dz droll dpitch dyaw").unwrap();
        assert_eq!(first, Some(vec![1, 2, 3, 4, 5, 6, 0]));
        assert_eq!(of("a b c d e f g").unwrap(), None, "by place");
        let error = of("dy dx c d e f g").unwrap_err().to_string();
        assert!(error.contains("dy dx c d e f g"), "{error}");
        let actions = Actions {
            space: Some(bridge),
            derived: None,
            unfit: None,
            order: first,
            mapping: ActionMapping {
                gripper: Some("-1:1".parse().unwrap()),
                ..ActionMapping::default()
            },
            period_s: 0.2,
        };
        let mut rows = vec![vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]];
        actions.map(&mut rows);
        assert_eq!(rows, [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.5]]);
    }
}
