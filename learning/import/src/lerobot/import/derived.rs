//! Derives an action space from the names of a data set's values and from its first episodes.

mod evidence;
mod table;

use wm_motion::actions::{
    ActionError, ActionSpace, ActionSurvey, Cause, Dimension, Kind, MAX_DIMENSIONS, Spread,
    StateComparison, StateRelation,
};

use super::{
    SURVEY_EPISODES,
    episode::{self, Values},
    value_name::ValueName,
};
use crate::{
    ActionMapping,
    lerobot::{
        dataset::{Dataset, Rows},
        info::{ACTION, Feature, STATE},
    },
};
use evidence::{Derivation, Evidence, shared_form};

/// Most rows that are measured: 14 hours at 10 Hz, 60 MB.
const ROWS_LIMIT: usize = 500_000;
/// Greatest rate of an action space \[Hz\].
const RATE_LIMIT: f64 = 1000.0;
/// Longest name of a value or a space \[characters\].
const NAME_LIMIT: usize = 64;

/// An action space that was derived, with the reason for each kind.
#[derive(Clone, Debug)]
pub(super) struct DerivedSpace {
    pub space: ActionSpace,
    values: Vec<Derivation>,
    episodes: usize,
}

/// Values of the measured episodes.
struct Measured {
    /// By episode, (T, values).
    episodes: Vec<Vec<Vec<f32>>>,
    /// Of each value with a partner in the state.
    comparisons: Vec<Option<StateComparison>>,
}

/// Names and rate of a data set's values.
#[derive(Clone, Debug)]
struct Description {
    robot: String,
    /// Of the actions.
    names: Vec<String>,
    /// Of the state.
    states: Vec<String>,
    /// \[Hz\]
    rate: f64,
}

impl DerivedSpace {
    /// Derives the space of a data set's actions from its first episodes, whichever are imported, so that all shards and
    /// all subsets have the same. `None` without a readable episode.
    ///
    /// # Errors
    /// [`ActionError::Space`] for more values than an action may have.
    pub fn of(
        dataset: &Dataset,
        mapping: ActionMapping,
        rows: &mut Rows,
    ) -> Result<Option<Self>, ActionError> {
        let features = &dataset.info.features;
        let Some(feature) = features.get(ACTION) else {
            return Ok(None);
        };
        if feature.width() > MAX_DIMENSIONS {
            return Err(ActionError::Space(format!(
                "the data set's actions have {} values; an action may have at most {MAX_DIMENSIONS}",
                feature.width()
            )));
        }
        let robot = dataset.info.robot_type.clone();
        let states = features.get(STATE);
        let description = Description {
            robot: robot
                .filter(|name| !name.is_empty())
                .unwrap_or_else(|| "derived".to_owned()),
            names: feature.value_names(),
            states: states.map_or(Vec::new(), Feature::value_names),
            rate: dataset.info.fps,
        };
        let entries = dataset.episodes.iter().take(SURVEY_EPISODES);
        // Unreadable episodes are named during the import.
        let episodes = entries.filter_map(|entry| episode::read_values(dataset, entry, rows).ok());
        Self::derive(description, mapping, episodes)
    }

    fn derive(
        description: Description,
        mapping: ActionMapping,
        episodes: impl Iterator<Item = Values>,
    ) -> Result<Option<Self>, ActionError> {
        let Description {
            robot,
            names,
            states,
            rate,
        } = description;
        let words: Vec<ValueName> = names.iter().map(|name| ValueName::new(name)).collect();
        let partners = partners(&names, &words, &states);
        let names = unique(names);
        let measured = Measured::of(episodes, rate, mapping, &words, &partners);
        let spreads = (0..names.len()).map(|index| Spread::of(measured.column(index)));
        let Some(spreads) = spreads.collect::<Option<Vec<Spread>>>() else {
            return Ok(None);
        };
        let relations: Vec<Option<StateRelation>> = measured.relations();
        let shared = shared_form(&relations, rate);
        let mut values = Vec::with_capacity(names.len());
        for (index, (words, spread)) in words.iter().zip(spreads).enumerate() {
            let partner = partners.get(index).and_then(Option::as_ref);
            let evidence = Evidence {
                words,
                spread,
                rate,
                partner,
                relation: relations.get(index).copied().flatten(),
                shared: shared.filter(|_| partner.is_some()),
            };
            values.push(match words.is_gripper() {
                true => evidence.gripper(measured.column(index)),
                false => evidence.value(),
            });
        }
        let rate = rate.min(RATE_LIMIT);
        let mut derived = Self {
            space: space(&robot, &names, &values, rate)?,
            values,
            episodes: measured.episodes.len(),
        };
        derived.revise(&measured, &robot, &names)?;
        Ok(Some(derived))
    }

    /// Gives up kinds and units that the values contradict: changes whose sum is beyond any reach are positions.
    fn revise(
        &mut self,
        measured: &Measured,
        name: &str,
        names: &[String],
    ) -> Result<(), ActionError> {
        let rate = self.space.rate();
        let mut survey = ActionSurvey::new(self.space.clone(), rate);
        for actions in &measured.episodes {
            survey.add(actions, &[] as &[Vec<f32>]);
        }
        let found = survey.contradictions();
        let absolute = found.iter().filter(|found| found.cause == Cause::Absolute);
        for found in absolute {
            let index = names.iter().position(|name| *name == found.column);
            if let Some(value) = index.and_then(|index| self.values.get_mut(index)) {
                value.kind = Kind::Position;
                value.unit = "1";
                value.reason = "its sum is beyond any arm's reach, so it is no change".to_owned();
            }
        }
        let limit = |value: &Derivation| {
            let plain = dimension(name, value.kind, value.unit, &value.spread);
            f64::from(plain.limit_over(rate.recip()))
        };
        let is_impossible = |value: &&Derivation| {
            let most = value.spread.least.abs().max(value.spread.most.abs());
            value.unit != "1" && most > limit(value)
        };
        // Values of one kind share their unit: a joint that turns by 10 degrees only is in degrees too.
        let impossible: Vec<(Kind, &str, f64)> = self
            .values
            .iter()
            .filter(is_impossible)
            .map(|value| (value.kind, value.unit, limit(value)))
            .collect();
        for value in &mut self.values {
            let mut alike = impossible.iter();
            if let Some((_, unit, limit)) =
                alike.find(|(kind, unit, _)| (*kind, *unit) == (value.kind, value.unit))
            {
                value.reason = format!(
                    "{}; values of this kind beyond any arm's {limit:.1} {unit}: unknown unit",
                    value.reason
                );
                value.unit = "1";
            }
        }
        self.space = space(name, names, &self.values, rate)?;
        Ok(())
    }
}

impl Measured {
    fn of(
        episodes: impl Iterator<Item = Values>,
        rate: f64,
        mapping: ActionMapping,
        words: &[ValueName],
        partners: &[Option<Partner>],
    ) -> Self {
        let new = |partner: &Option<Partner>| partner.as_ref().map(|_| StateComparison::new(rate));
        let mut measured = Self {
            episodes: Vec::new(),
            comparisons: partners.iter().map(new).collect(),
        };
        let mut count = 0;
        for (mut actions, states) in episodes {
            count += actions.len();
            if count > ROWS_LIMIT && !measured.episodes.is_empty() {
                break;
            }
            if !actions.iter().flatten().copied().all(f32::is_finite) {
                continue;
            }
            if let Some(range) = mapping.gripper {
                for action in &mut actions {
                    let grippers = action.iter_mut().zip(words);
                    let grippers = grippers.filter(|(_, words)| words.is_gripper());
                    grippers.for_each(|(value, _)| range.open_to(value));
                }
            }
            measured.compare(&actions, &states, partners);
            measured.episodes.push(actions);
        }
        measured
    }

    fn compare(&mut self, actions: &[Vec<f32>], states: &[Vec<f64>], partners: &[Option<Partner>]) {
        if states.len() != actions.len() || !states.iter().flatten().copied().all(f64::is_finite) {
            return;
        }
        let pairs = self.comparisons.iter_mut().zip(partners).enumerate();
        for (index, (comparison, partner)) in pairs {
            if let (Some(comparison), Some(partner)) = (comparison, partner) {
                let values = actions.iter().filter_map(|row| row.get(index).copied());
                let states = states
                    .iter()
                    .filter_map(|row| row.get(partner.column).copied());
                comparison.add(&values.collect::<Vec<_>>(), &states.collect::<Vec<_>>());
            }
        }
    }

    fn column(&self, index: usize) -> impl Iterator<Item = f32> + '_ {
        let rows = self.episodes.iter().flatten();
        rows.filter_map(move |row| row.get(index).copied())
    }

    fn relations(&self) -> Vec<Option<StateRelation>> {
        let relation = |comparison: &Option<StateComparison>| comparison.as_ref()?.relation();
        self.comparisons.iter().map(relation).collect()
    }
}

/// The value of the state that a value of the actions may move.
#[derive(Clone, Debug, PartialEq)]
struct Partner {
    column: usize,
    name: String,
    /// Whether the names are equal, apart from words such as "position" and "velocity".
    is_named: bool,
}

/// For each value of the actions, the position in the state of the same name, else of the same words, else at the same
/// place.
fn partners(names: &[String], words: &[ValueName], states: &[String]) -> Vec<Option<Partner>> {
    let of_states: Vec<ValueName> = states.iter().map(|name| ValueName::new(name)).collect();
    let is_position = |column: usize| of_states.get(column).is_some_and(ValueName::is_position);
    let partner = |(index, (name, words)): (usize, (&String, &ValueName))| {
        if words.is_gripper() {
            return None;
        }
        let mut columns = (0..states.len()).filter(|column| is_position(*column));
        let same = |column: &usize| states.get(*column) == Some(name);
        let alike = |column: &usize| {
            let core = words.core();
            let state = of_states.get(*column).map(ValueName::core);
            !core.is_empty() && state.is_some_and(|state| state == core)
        };
        let named = columns
            .clone()
            .find(same)
            .or_else(|| columns.clone().find(alike));
        let column = named.or_else(|| columns.find(|column| *column == index))?;
        Some(Partner {
            column,
            name: states.get(column)?.clone(),
            is_named: named.is_some(),
        })
    };
    names.iter().zip(words).enumerate().map(partner).collect()
}

/// A dimension before its scale is fitted; a constant state is at 0 in model units.
fn dimension(name: &str, kind: Kind, unit: &str, spread: &Spread) -> Dimension {
    let offset = match kind.is_motion() || kind.is_gripper() {
        true => 0.0,
        // Actions have single precision.
        false => spread.low as f32,
    };
    Dimension {
        name: name.to_owned(),
        unit: unit.to_owned(),
        kind,
        offset,
        scale: 1.0,
        clip: 1.0,
    }
}

fn space(
    name: &str,
    names: &[String],
    values: &[Derivation],
    rate: f64,
) -> Result<ActionSpace, ActionError> {
    let dimensions = names
        .iter()
        .zip(values)
        .map(|(name, value)| dimension(name, value.kind, value.unit, &value.spread));
    let spreads: Vec<Spread> = values.iter().map(|value| value.spread).collect();
    ActionSpace::new(shorten(name), rate, dimensions.collect())?.fitted(&spreads)
}

fn shorten(name: &str) -> String {
    name.chars().take(NAME_LIMIT).collect()
}

/// Names that an action space may have: of limited length, and each only once.
fn unique(names: Vec<String>) -> Vec<String> {
    let mut found: Vec<String> = Vec::with_capacity(names.len());
    for (index, name) in names.into_iter().enumerate() {
        let name = shorten(&name);
        let is_free = !name.is_empty() && !found.contains(&name);
        found.push(match is_free {
            true => name,
            false => format!("value_{index}_of_action"),
        });
    }
    found
}

#[cfg(test)]
mod tests;
