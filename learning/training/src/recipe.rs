//! Recipes: every number of a training, in an annotated YAML file.
//!
//! `tiny` (for a CPU) and `paper` are part of the program, from `recipes/`; any file takes their place. A setting is
//! overridden by its path, as `optimiser.learning_rate=1e-3`. Nothing is optional, so that a recipe tells all; the
//! resolved one is written beside the weights.

mod span;

use std::{fmt, path::Path, str::FromStr};

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_yaml_ng::Value;
use thiserror::Error;

use crate::optimiser::{AdamWSettings, Schedule};
pub use span::Span;

/// Why a recipe cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecipeError {
    /// The file cannot be read or written.
    #[error("{path}: {reason}")]
    Io {
        /// The file.
        path: String,
        /// Why. No source, since the message has it.
        reason: std::io::Error,
    },
    /// The file is no recipe of this training.
    #[error("recipe {recipe}: {reason}")]
    Malformed {
        /// Name or file of the recipe.
        recipe: String,
        /// What is wrong, and where.
        reason: serde_yaml_ng::Error,
    },
    /// There is no setting of this path.
    #[error("recipe {recipe} has no setting `{path}`; at this place it has {there}")]
    Unknown {
        /// Name or file of the recipe.
        recipe: String,
        /// What was asked for.
        path: String,
        /// The settings that there are.
        there: String,
    },
    /// This training has no recipe of this name.
    #[error("recipe {recipe}: expected {names}, or a YAML file")]
    NoSuchRecipe {
        /// What was asked for.
        recipe: String,
        /// The recipes that there are.
        names: String,
    },
}

/// One setting overridden: `path.to.setting=value`, the value in YAML.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    path: String,
    value: Value,
    only_if_null: bool,
}

impl FromStr for Override {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (path, value) = text
            .split_once('=')
            .ok_or("expected path.to.setting=value")?;
        Ok(Self {
            path: path.trim().to_owned(),
            value: serde_yaml_ng::from_str(value).map_err(|error| error.to_string())?,
            only_if_null: false,
        })
    }
}

impl Override {
    /// `path` becomes `value`.
    pub fn new(path: &str, value: impl Into<Value>) -> Self {
        Self {
            path: path.to_owned(),
            value: value.into(),
            only_if_null: false,
        }
    }

    /// The first name of its path.
    #[must_use]
    pub fn part(&self) -> &str {
        self.path.split('.').next().unwrap_or_default()
    }

    /// The same without the first name of its path.
    #[must_use]
    pub fn of_part(&self) -> Self {
        let (_, rest) = self.path.split_once('.').unwrap_or_default();
        Self {
            path: rest.to_owned(),
            ..self.clone()
        }
    }

    /// `path` becomes `value` where the recipe leaves it open (null).
    pub fn if_open(path: &str, value: impl Into<Value>) -> Self {
        Self {
            only_if_null: true,
            ..Self::new(path, value)
        }
    }

    fn apply(&self, recipe: &str, root: &mut Value) -> Result<(), RecipeError> {
        let mut place = root;
        for key in self.path.split('.') {
            let there = keys(place);
            place = place.get_mut(key).ok_or_else(|| RecipeError::Unknown {
                recipe: recipe.to_owned(),
                path: self.path.clone(),
                there,
            })?;
        }
        if place.is_null() || !self.only_if_null {
            *place = self.value.clone();
        }
        Ok(())
    }
}

fn keys(place: &Value) -> String {
    let Some(mapping) = place.as_mapping() else {
        return "a value".into();
    };
    let keys = mapping.keys().filter_map(Value::as_str);
    keys.collect::<Vec<_>>().join(", ")
}

/// The recipes of one training that are part of the program: name and YAML.
pub type Bundled = &'static [(&'static str, &'static str)];

/// Reads the recipe `choice`, a name in `bundled` or a file, with some settings overridden.
///
/// # Errors
/// When there is no such recipe or setting, or a value is missing, unknown or of the wrong type.
pub fn load<R: DeserializeOwned>(
    bundled: Bundled,
    choice: &str,
    overrides: &[Override],
) -> Result<R, RecipeError> {
    let text = match bundled.iter().find(|(name, _)| *name == choice) {
        Some((_, text)) => (*text).to_owned(),
        None if Path::new(choice).exists() => {
            std::fs::read_to_string(choice).map_err(|reason| RecipeError::Io {
                path: choice.to_owned(),
                reason,
            })?
        }
        None => {
            let names = bundled.iter().map(|(name, _)| *name);
            return Err(RecipeError::NoSuchRecipe {
                recipe: choice.to_owned(),
                names: names.collect::<Vec<_>>().join(" or "),
            });
        }
    };
    let malformed = |reason| RecipeError::Malformed {
        recipe: choice.to_owned(),
        reason,
    };
    let mut value: Value = serde_yaml_ng::from_str(&text).map_err(malformed)?;
    for setting in overrides {
        setting.apply(choice, &mut value)?;
    }
    // By way of text: the error for a wrong value then tells the path to it.
    let text = serde_yaml_ng::to_string(&value).map_err(malformed)?;
    serde_yaml_ng::from_str(&text).map_err(malformed)
}

/// Writes a resolved recipe as `folder/NAME.recipe.yaml`.
///
/// # Errors
/// When the file cannot be written.
pub fn write(folder: &Path, name: &str, recipe: &impl Serialize) -> Result<(), RecipeError> {
    let path = folder.join(format!("{name}.recipe.yaml"));
    let text = serde_yaml_ng::to_string(recipe).map_err(|reason| RecipeError::Malformed {
        recipe: name.to_owned(),
        reason,
    })?;
    let text =
        format!("# What `wm train {name}` was run with: pass it as --recipe to repeat it.\n{text}");
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, text))
        .map_err(|reason| RecipeError::Io {
            path: path.display().to_string(),
            reason,
        })
}

/// What of a recipe decides the result, step by step: all but how long it goes on and how often it saves.
///
/// # Errors
/// When a value cannot be told in JSON.
pub fn identity(recipe: &impl Serialize) -> Result<serde_json::Value, serde_json::Error> {
    let mut identity = serde_json::to_value(recipe)?;
    if let Some(settings) = identity.as_object_mut() {
        for key in ["length", "validate_every", "checkpoint_seconds"] {
            settings.remove(key);
        }
    }
    Ok(identity)
}

/// A recipe of a training.
pub trait Recipe: Serialize {
    /// What every recipe has.
    fn course(&self) -> Course<'_>;
}

/// What every recipe has.
#[derive(Clone, Copy, Debug)]
pub struct Course<'a> {
    /// How long to train.
    pub length: Span,
    /// Samples a step.
    pub batch: usize,
    /// Steps between validations.
    pub validate_every: u64,
    /// Wall-clock time between checkpoints \[s\].
    pub checkpoint_seconds: u64,
    /// How to step.
    pub optimisation: &'a Optimisation,
}

impl Course<'_> {
    /// Steps of an epoch of `samples`.
    #[must_use]
    pub fn per_epoch(&self, samples: usize) -> f64 {
        samples as f64 / self.batch.max(1) as f64
    }
}

/// Makes a struct with the fields of a [`Course`] a [`Recipe`].
macro_rules! is_recipe {
    ($recipe:ty) => {
        impl $crate::recipe::Recipe for $recipe {
            fn course(&self) -> $crate::recipe::Course<'_> {
                $crate::recipe::Course {
                    length: self.length,
                    batch: self.batch,
                    validate_every: self.validate_every,
                    checkpoint_seconds: self.checkpoint_seconds,
                    optimisation: &self.optimisation,
                }
            }
        }
    };
}

pub(crate) use is_recipe;

/// How a training steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optimisation {
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Over which the learning rate rises.
    pub warm_up: Span,
    /// Last learning rate as a fraction of the highest; it falls along half a cosine.
    pub final_rate: f64,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay, multiplied by the learning rate.
    pub weight_decay: f64,
    /// The gradient is scaled down to this global norm.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights, which is what is saved.
    pub ema_decay: f64,
}

impl Optimisation {
    /// The optimiser's settings.
    #[must_use]
    pub fn adamw(&self) -> AdamWSettings {
        AdamWSettings {
            beta1: self.beta1,
            beta2: self.beta2,
            epsilon: self.epsilon,
            weight_decay: self.weight_decay,
            clip_norm: self.clip_norm,
            ema_decay: self.ema_decay,
        }
    }

    /// The learning rates of `steps` steps, of which an epoch has `per_epoch`.
    #[must_use]
    pub fn schedule(&self, steps: u64, per_epoch: f64) -> Schedule {
        let warm_up = self.warm_up.steps(per_epoch);
        Schedule::new(self.learning_rate, warm_up, steps, self.final_rate)
    }
}

impl fmt::Display for Override {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = serde_yaml_ng::to_string(&self.value).unwrap_or_default();
        write!(f, "{}={}", self.path, value.trim())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Recipe {
        seed: u64,
        length: Span,
        inner: Inner,
    }

    #[derive(Debug, PartialEq, Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        rate: f64,
        width: Option<usize>,
    }

    const BUNDLED: Bundled = &[(
        "tiny",
        "seed: 1\nlength: 100 epochs\ninner: {rate: 1.0e-3, width: null}\n",
    )];

    fn overridden(setting: &str) -> Result<Recipe, RecipeError> {
        load(BUNDLED, "tiny", &[setting.parse().unwrap()])
    }

    #[test]
    fn every_setting_is_overridden_by_its_path() {
        assert_eq!(overridden("inner.rate=2e-4").unwrap().inner.rate, 2e-4);
        assert_eq!(overridden("inner.width=64").unwrap().inner.width, Some(64));
        let length = overridden("length=30 steps").unwrap().length;
        assert_eq!(length, Span::Steps(30));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let error = overridden("inner.rates=1").unwrap_err().to_string();
        assert!(
            error.contains("inner.rates") && error.contains("rate, width"),
            "{error}"
        );
        let error = overridden("seed=many").unwrap_err().to_string();
        assert!(error.contains("seed") && error.contains("many"), "{error}");
        let error = load::<Recipe>(BUNDLED, "huge", &[])
            .unwrap_err()
            .to_string();
        assert!(error.contains("huge") && error.contains("tiny"), "{error}");
        assert!("seed".parse::<Override>().is_err());
    }

    #[test]
    fn what_was_resolved_is_a_recipe_again() {
        let dir = tempfile::tempdir().unwrap();
        let recipe = overridden("inner.width=64").unwrap();
        write(dir.path(), "autoencoder", &recipe).unwrap();
        let path = dir.path().join("autoencoder.recipe.yaml");
        let again: Recipe = load(BUNDLED, path.to_str().unwrap(), &[]).unwrap();
        assert_eq!(again, recipe);
    }
}
