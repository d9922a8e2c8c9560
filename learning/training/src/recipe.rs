//! Recipes: all settings of a training, in an annotated YAML file.
//!
//! `tiny` (for a CPU) and `paper` are embedded from `recipes/`; any file may replace them. Settings are overridden by
//! path, such as `optimiser.learning_rate=1e-3`. Nothing is optional, so that a recipe is complete; the resolved one is
//! written beside the weights.

mod span;

use std::{fmt, path::Path, str::FromStr};

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_yaml_ng::Value;
use thiserror::Error;

use crate::{
    optimiser::{AdamWSettings, Schedule},
    workers::Batches,
};
pub use span::Span;

/// An unusable recipe.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RecipeError {
    /// A file that cannot be read or written.
    #[error("{path}: {reason}")]
    Io {
        /// Path of the file.
        path: String,
        /// Cause; not a `source`, since the message includes it.
        reason: std::io::Error,
    },
    /// An invalid recipe file.
    #[error("recipe {recipe}: {reason}")]
    Malformed {
        /// Name or file of the recipe.
        recipe: String,
        /// Fault with its location.
        reason: serde_yaml_ng::Error,
    },
    /// An unknown setting.
    #[error("recipe {recipe} has no setting `{path}`; expected {there}")]
    Unknown {
        /// Name or file of the recipe.
        recipe: String,
        /// Requested path.
        path: String,
        /// Known settings.
        there: String,
    },
    /// An unknown recipe.
    #[error("recipe {recipe}: expected {names}, or a YAML file")]
    NoSuchRecipe {
        /// Requested name.
        recipe: String,
        /// Known names.
        names: String,
    },
}

/// An overridden setting: `path.to.setting=value`, with the value in YAML.
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
    /// Sets `path` to `value`.
    pub fn new(path: &str, value: impl Into<Value>) -> Self {
        Self {
            path: path.to_owned(),
            value: value.into(),
            only_if_null: false,
        }
    }

    /// Names of the setting, with dots between them.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// First name of the path.
    #[must_use]
    pub fn part(&self) -> &str {
        // `split` gives at least one part.
        self.path.split('.').next().unwrap_or_default()
    }

    /// The override without the first name of its path.
    #[must_use]
    pub fn of_part(&self) -> Self {
        // A path with a single name has no rest, which `load` reports.
        let (_, rest) = self.path.split_once('.').unwrap_or_default();
        Self {
            path: rest.to_owned(),
            ..self.clone()
        }
    }

    /// Sets `path` to `value` if the recipe leaves it open (null).
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

/// Embedded recipes of one training: name and YAML.
pub type Bundled = &'static [(&'static str, &'static str)];

/// Reads the recipe `choice` (a name in `bundled`, or a file) with overridden settings.
///
/// # Errors
/// For an unknown recipe or setting, or a missing, unknown or mistyped value.
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
    // Through text, so that an error names the path of the value.
    let text = serde_yaml_ng::to_string(&value).map_err(malformed)?;
    serde_yaml_ng::from_str(&text).map_err(malformed)
}

/// Writes a resolved recipe as `folder/NAME.recipe.yaml`.
///
/// # Errors
/// If the file cannot be written.
pub fn write(folder: &Path, name: &str, recipe: &impl Serialize) -> Result<(), RecipeError> {
    let path = folder.join(format!("{name}.recipe.yaml"));
    let text = serde_yaml_ng::to_string(recipe).map_err(|reason| RecipeError::Malformed {
        recipe: name.to_owned(),
        reason,
    })?;
    let text = format!(
        "# Settings of `wm train {name}`: pass this file as --recipe to repeat it.\n{text}"
    );
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, text))
        .map_err(|reason| RecipeError::Io {
            path: path.display().to_string(),
            reason,
        })
}

/// The parts of a recipe that affect each step: everything except the length and the times of saving.
///
/// # Errors
/// If a value cannot be written as JSON.
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
pub trait Recipe: Serialize + DeserializeOwned {
    /// Embedded recipes.
    const BUNDLED: Bundled;

    /// Settings common to all recipes.
    fn course(&self) -> Course<'_>;
}

/// Settings common to all recipes.
#[derive(Clone, Copy, Debug)]
pub struct Course<'a> {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Length of the training.
    pub length: Span,
    /// Samples per step.
    pub batch: usize,
    /// Samples computed together.
    pub micro_batch: usize,
    /// Steps between validations.
    pub validate_every: u64,
    /// Wall-clock time between checkpoints \[s\].
    pub checkpoint_seconds: u64,
    /// Optimiser settings.
    pub optimisation: &'a Optimisation,
}

impl Course<'_> {
    /// Steps of an epoch of `samples`.
    #[must_use]
    pub fn per_epoch(&self, samples: usize) -> f64 {
        samples as f64 / self.batch.max(1) as f64
    }

    /// The batches of step 0. [`check_batch`] excludes an empty one.
    pub(crate) fn batches(&self) -> Batches {
        Batches {
            count: self.batch / self.micro_batch.max(1),
            seed: self.seed,
            step: 0,
        }
    }
}

/// Checks that a batch of at least one sample splits into small batches of `micro_batch`.
pub(crate) fn check_batch(batch: usize, micro_batch: usize) -> anyhow::Result<()> {
    anyhow::ensure!(
        batch > 0 && micro_batch > 0 && batch.is_multiple_of(micro_batch),
        "batch {batch} cannot be split into parts of micro_batch {micro_batch}"
    );
    Ok(())
}

/// Defines a [`Recipe`] of the embedded files `recipes/NAME/FILE.yaml`, with the settings of a [`Course`].
macro_rules! recipe {
    (
        $(#[$about:meta])*
        pub struct $recipe:ident in [$($name:literal),+] of $file:literal {
            $($(#[$doc:meta])* pub $field:ident: $type:ty,)*
        }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $recipe {
            /// Seed of all random numbers.
            pub seed: u64,
            /// Length of the training; an epoch is one random sample of each episode.
            pub length: $crate::recipe::Span,
            /// Steps between validations.
            pub validate_every: u64,
            /// Wall-clock time between checkpoints \[s\].
            pub checkpoint_seconds: u64,
            /// Samples per step.
            pub batch: usize,
            /// Samples computed together.
            pub micro_batch: usize,
            $($(#[$doc])* pub $field: $type,)*
            /// The optimiser.
            pub optimisation: $crate::recipe::Optimisation,
        }

        impl $crate::recipe::Recipe for $recipe {
            const BUNDLED: $crate::recipe::Bundled = &[$((
                $name,
                include_str!(concat!(
                    env!("CARGO_MANIFEST_DIR"), "/recipes/", $name, "/", $file, ".yaml"
                )),
            )),+];

            fn course(&self) -> $crate::recipe::Course<'_> {
                $crate::recipe::Course {
                    seed: self.seed,
                    length: self.length,
                    batch: self.batch,
                    micro_batch: self.micro_batch,
                    validate_every: self.validate_every,
                    checkpoint_seconds: self.checkpoint_seconds,
                    optimisation: &self.optimisation,
                }
            }
        }
    };
}

pub(crate) use recipe;

/// Optimiser settings of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optimisation {
    /// Highest learning rate.
    pub learning_rate: f64,
    /// Length of the warm-up.
    pub warm_up: Span,
    /// Last learning rate as a fraction of the highest; the decay is half a cosine.
    pub final_rate: f64,
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay, multiplied by the learning rate.
    pub weight_decay: f64,
    /// Greatest global norm of the gradient.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights, which is saved.
    pub ema_decay: f64,
}

impl Optimisation {
    /// Settings of the optimiser.
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

    /// Learning rates of `steps` steps, with `per_epoch` steps per epoch.
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
pub(crate) mod tests {
    use super::*;

    /// The bundled recipe `name` with these settings.
    pub(crate) fn bundled<R: super::Recipe>(name: &str, settings: &[&str]) -> R {
        let settings: Vec<Override> = settings
            .iter()
            .map(|setting| setting.parse().unwrap())
            .collect();
        load(R::BUNDLED, name, &settings).unwrap()
    }

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
    fn settings_are_overridden_by_path() {
        assert_eq!(overridden("inner.rate=2e-4").unwrap().inner.rate, 2e-4);
        assert_eq!(overridden("inner.width=64").unwrap().inner.width, Some(64));
        let length = overridden("length=30 steps").unwrap().length;
        assert_eq!(length, Span::Steps(30));
    }

    #[test]
    fn faults_are_named() {
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
    fn resolved_recipe_is_a_recipe() {
        let dir = tempfile::tempdir().unwrap();
        let recipe = overridden("inner.width=64").unwrap();
        write(dir.path(), "autoencoder", &recipe).unwrap();
        let path = dir.path().join("autoencoder.recipe.yaml");
        let again: Recipe = load(BUNDLED, path.to_str().unwrap(), &[]).unwrap();
        assert_eq!(again, recipe);
    }
}
