//! The dimensions of the actions that are searched.

use std::{fmt, str::FromStr};

use anyhow::{Result, ensure};
use candle_core::Tensor;
use serde::{Deserialize, Serialize};
use wm_motion::actions::{ActionSpace, Kind};
use wm_planner::{Dynamics as _, TransitionDynamics};

use crate::{Settings, Subject, Windows};

/// Windows in which the effects of the dimensions are measured.
const EFFECT_WINDOWS: usize = 24;

/// A choice of dimensions. The others keep their true values.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum SearchedDimensions {
    /// All, as in the paper.
    All,
    /// Those with an effect on predictions of the held-out data, by `least_effect`.
    #[default]
    Effective,
    /// The translations.
    Translations,
    /// These.
    Named(Vec<String>),
}

impl fmt::Display for SearchedDimensions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Effective => f.write_str("effective"),
            Self::Translations => f.write_str("translations"),
            Self::Named(names) => f.write_str(&names.join(",")),
        }
    }
}

impl From<SearchedDimensions> for String {
    fn from(searched: SearchedDimensions) -> Self {
        searched.to_string()
    }
}

impl FromStr for SearchedDimensions {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> Result<Self> {
        Ok(match text {
            "all" => Self::All,
            "effective" => Self::Effective,
            "translations" => Self::Translations,
            names => {
                let names: Vec<String> = names.split(',').map(|name| name.trim().into()).collect();
                ensure!(
                    names.iter().all(|name| !name.is_empty()),
                    "searched dimensions are {text:?}; expected all, effective, translations or names such as dx,dy"
                );
                Self::Named(names)
            }
        })
    }
}

impl TryFrom<String> for SearchedDimensions {
    type Error = anyhow::Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

/// The searched dimensions of a model.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Searched {
    /// Their indices.
    pub indices: Vec<usize>,
    /// Effect of each dimension of the action space, by its index; empty unless it decided.
    pub effects: Vec<f64>,
}

impl Searched {
    /// Without searches.
    pub fn nothing() -> Self {
        Self {
            indices: Vec::new(),
            effects: Vec::new(),
        }
    }

    /// Chooses the dimensions by the settings.
    ///
    /// # Errors
    /// If a name is unknown, or there is no dimension to search.
    pub fn of(subject: &Subject, settings: &Settings, windows: &Windows) -> Result<Self> {
        let own = &settings.control;
        let space = subject.world.encoding.space();
        let mut effects = Vec::new();
        let indices: Vec<usize> = match &own.searched {
            SearchedDimensions::All => (0..space.len()).collect(),
            SearchedDimensions::Translations => translations(space),
            SearchedDimensions::Named(names) => named(space, names)?,
            SearchedDimensions::Effective => {
                effects = measure_effects(subject, settings, windows)?;
                let each = effects.iter().enumerate();
                each.filter(|(_, effect)| **effect >= own.least_effect)
                    .map(|(index, _)| index)
                    .collect()
            }
        };
        ensure!(
            !indices.is_empty(),
            "no dimension of {space} is searched by {}; effects {effects:.3?}",
            own.searched
        );
        Ok(Self { indices, effects })
    }
}

/// Indices of the translations.
pub(super) fn translations(space: &ActionSpace) -> Vec<usize> {
    let each = space.dimensions().iter().enumerate();
    each.filter(|(_, dimension)| dimension.kind == Kind::TranslationDelta)
        .map(|(index, _)| index)
        .collect()
}

fn named(space: &ActionSpace, names: &[String]) -> Result<Vec<usize>> {
    for name in names {
        ensure!(
            space.dimensions().iter().any(|own| own.name == *name),
            "unknown dimension {name:?} to search; the model's are {space}"
        );
    }
    let each = space.dimensions().iter().enumerate();
    Ok(each
        .filter(|(_, own)| names.contains(&own.name))
        .map(|(index, _)| index)
        .collect())
}

/// Effect of each dimension: squared change of the predicted latent if the dimension changes by its standard deviation in
/// the data, over the squared change from the last observed latent. A dimension that is constant in the data has none.
fn measure_effects(subject: &Subject, settings: &Settings, windows: &Windows) -> Result<Vec<f64>> {
    let values = subject.world.encoding.space().len();
    let units: Vec<usize> = (0..windows.len()).take(EFFECT_WINDOWS).collect();
    let mut rows = Vec::new();
    for unit in &units {
        rows.extend(windows.actions(*unit)?.to_vec2::<f32>()?);
    }
    let deviations = deviations(&rows, values);
    let (mut changed, mut moved) = (vec![0.0; values], 0.0);
    for unit in units {
        let (context, past) = windows.context(unit)?;
        let seed = settings.seed.wrapping_add(unit as u64);
        let (model, sampler) = (&subject.world.transition, subject.sampler());
        let mut dynamics = TransitionDynamics::new(model, sampler, &context, Some(&past), seed)?;
        let truth = windows
            .actions(unit)?
            .narrow(0, 0, 1)?
            .to_vec2::<f32>()?
            .concat();
        let mut candidates = truth.clone();
        for (index, deviation) in deviations.iter().enumerate() {
            let changed = truth
                .iter()
                .enumerate()
                .map(|(at, value)| match at == index {
                    true => value + deviation,
                    false => *value,
                });
            candidates.extend(changed);
        }
        let shape = (values + 1, 1, truth.len());
        let candidates = Tensor::from_vec(candidates, shape, past.device())?;
        let latents = dynamics.rollout(&candidates)?;
        let own = latents.get(0)?;
        for (index, changed) in changed.iter_mut().enumerate() {
            *changed += crate::squared(&latents.get(index + 1)?, &own)?;
        }
        moved += crate::squared(&own, &windows.last_observed(unit)?)?;
    }
    Ok(changed.into_iter().map(|changed| changed / moved).collect())
}

/// Standard deviation of each of the first `values` values of the rows.
fn deviations(rows: &[Vec<f32>], values: usize) -> Vec<f32> {
    let n = rows.len().max(1) as f64;
    let of = |index: usize| {
        let column = || {
            rows.iter()
                .filter_map(move |row| row.get(index))
                .map(|v| f64::from(*v))
        };
        let mean = column().sum::<f64>() / n;
        let variance = column().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
        variance.sqrt() as f32
    };
    (0..values).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dimensions_are_chosen_by_name() {
        let space = ActionSpace::bridge();
        assert_eq!(translations(&space), [0, 1, 2]);
        let names = |text: &str| match text.parse().unwrap() {
            SearchedDimensions::Named(names) => named(&space, &names),
            other => panic!("{other}"),
        };
        let dimensions = space.dimensions();
        let (first, last) = (&dimensions[0].name, &dimensions[6].name);
        assert_eq!(names(&format!("{last}, {first}")).unwrap(), [0, 6]);
        let error = names("wrist").unwrap_err().to_string();
        assert!(error.contains("wrist") && error.contains(first), "{error}");
        assert!("dx,,dy".parse::<SearchedDimensions>().is_err());
        for text in ["all", "effective", "translations", "dx,dy"] {
            assert_eq!(
                text.parse::<SearchedDimensions>().unwrap().to_string(),
                text
            );
        }
    }

    #[test]
    fn constant_values_do_not_deviate() {
        let rows = [vec![1.0, 3.0, 9.0], vec![1.0, 5.0, 9.0]];
        assert_eq!(deviations(&rows, 2), [0.0, 1.0]);
    }
}
