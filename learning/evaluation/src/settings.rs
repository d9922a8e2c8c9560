//! Extent and settings of a measurement.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;

use crate::control::SearchedDimensions;
use crate::policy::{PolicyInputs, PolicySettings};

/// Extent of a measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// A few minutes with a small model on two cores: fewer episodes and windows, otherwise as the paper
    #[default]
    Quick,
    /// The paper's numbers of episodes, windows and steps (appendix C), and searches over all dimensions
    Paper,
}

/// Settings of all suites. They are part of the results: only equal ones are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of all random numbers: noise, candidates, guesses, resamples.
    pub seed: u64,
    /// Resamples of a bootstrap.
    pub resamples: usize,
    /// See `FidelitySettings`.
    pub fidelity: FidelitySettings,
    /// See `ControlSettings`.
    pub control: ControlSettings,
    /// See `LatentsSettings`.
    pub latents: LatentsSettings,
    /// See `RobustnessSettings`.
    pub robustness: RobustnessSettings,
    /// See [`PolicySettings`].
    pub policy: PolicySettings,
    /// The user's networks, as in `Perception::description`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub networks: Option<Value>,
}

/// Decoded rollouts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FidelitySettings {
    /// Most episodes, evenly spread.
    pub episodes: usize,
    /// Most predicted steps; a rollout ends with its episode.
    pub steps: usize,
    /// Rollouts in the report.
    pub strips: usize,
}

/// Planning, and the response to actions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    /// The searches.
    pub searches: Vec<SearchSettings>,
    /// Searched dimensions: all (the paper's), effective, translations, or names.
    pub searched: SearchedDimensions,
    /// Least effect of an effective dimension: squared change of the predicted latent under a change by the dimension's
    /// standard deviation in the data, over that from the last observed latent.
    pub least_effect: f64,
    /// Candidates per iteration.
    pub population: usize,
    /// Iterations of a search.
    pub iterations: usize,
    /// Candidates that fit the next Gaussian.
    pub elites: usize,
    /// Candidates are clamped to plus or minus this \[model units\].
    pub bound: f32,
    /// First standard deviation as a share of that range.
    pub initial_std: f32,
    /// Most windows for the response to right and wrong actions.
    pub response_windows: usize,
    /// Predicted steps of these windows.
    pub response_steps: usize,
}

/// Searches over one number of steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchSettings {
    /// Steps k searched together.
    pub k: usize,
    /// Most windows, evenly spread.
    pub windows: usize,
}

/// Action recovery and success.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LatentsSettings {
    /// Most windows for inferred actions, evenly spread.
    pub windows: usize,
    /// Predicted steps of these windows, or more if the inverse dynamics model needs them.
    pub steps: usize,
    /// Most episodes with an instruction and an outcome, evenly spread.
    pub judged_episodes: usize,
    /// Most episodes for action trajectories, evenly spread.
    pub trajectories: usize,
}

/// Changed frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobustnessSettings {
    /// Most windows, evenly spread.
    pub windows: usize,
    /// Predicted steps.
    pub steps: usize,
}

impl Settings {
    /// Applies the settings in `text` (YAML or JSON).
    ///
    /// # Errors
    /// For an unknown setting, or a value of another type.
    pub fn with(&self, text: &str) -> Result<Self> {
        changed(self, text)
    }

    /// As YAML for [`Self::with`].
    ///
    /// # Errors
    /// None known: numbers and names have a YAML form.
    pub fn to_yaml(&self) -> Result<String> {
        Ok(serde_yaml_ng::to_string(self)?)
    }

    /// Settings of a model card: takes seconds, without searches.
    #[must_use]
    pub fn brief(seed: u64) -> Self {
        let mut settings = Self::of(Protocol::Quick, seed);
        settings.fidelity.episodes = 8;
        settings.fidelity.steps = 8;
        settings.control.searches.clear();
        settings.control.response_windows = 16;
        settings.latents.windows = 16;
        settings.latents.judged_episodes = 16;
        settings.latents.trajectories = 8;
        settings
    }

    /// Settings of a protocol.
    #[must_use]
    pub fn of(protocol: Protocol, seed: u64) -> Self {
        let is_paper = protocol == Protocol::Paper;
        let choose = |quick: usize, paper: usize| if is_paper { paper } else { quick };
        Self {
            seed,
            resamples: 10_000,
            fidelity: FidelitySettings {
                episodes: choose(20, 1000),
                steps: 45,
                strips: choose(3, 6),
            },
            control: ControlSettings {
                // A candidate of four steps takes four times as long.
                searches: vec![
                    SearchSettings {
                        k: 1,
                        windows: choose(12, 100),
                    },
                    SearchSettings {
                        k: 4,
                        windows: choose(4, 100),
                    },
                ],
                searched: match protocol {
                    Protocol::Quick => SearchedDimensions::default(),
                    Protocol::Paper => SearchedDimensions::All,
                },
                least_effect: 0.01,
                population: 400,
                iterations: 5,
                elites: 50,
                bound: 2.0,
                initial_std: 0.25,
                response_windows: choose(40, 100),
                response_steps: 8,
            },
            latents: LatentsSettings {
                windows: choose(40, 1000),
                steps: 8,
                judged_episodes: choose(40, 1000),
                // Records have all features; the paper does not state its number.
                trajectories: 40,
            },
            robustness: RobustnessSettings {
                windows: choose(16, 100),
                steps: 4,
            },
            policy: PolicySettings {
                tasks: choose(6, 20),
                trials: choose(2, 8),
                steps: choose(20, 50),
                strips: choose(3, 6),
                inputs: PolicyInputs::default(),
            },
            networks: None,
        }
    }
}

/// Replaces the settings named in a YAML text, at any depth.
pub(crate) fn changed<S: Serialize + DeserializeOwned>(settings: &S, text: &str) -> Result<S> {
    let changes: Value = serde_yaml_ng::from_str(text)?;
    ensure!(changes.is_object(), "expected settings by name");
    let mut settings = serde_json::to_value(settings)?;
    change(&mut settings, changes);
    Ok(serde_json::from_value(settings)?)
}

fn change(settings: &mut Value, changes: Value) {
    match (settings, changes) {
        (Value::Object(settings), Value::Object(changes)) => {
            for (name, value) in changes {
                change(settings.entry(name).or_insert(Value::Null), value);
            }
        }
        (setting, value) => *setting = value,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_settings_change_and_unknown_ones_are_rejected() {
        let settings = Settings::of(Protocol::Paper, 3);
        let changed = settings
            .with("control: {population: 7}\nresamples: 10")
            .unwrap();
        assert_eq!((changed.control.population, changed.resamples), (7, 10));
        assert_eq!((changed.seed, changed.control.elites), (3, 50));
        let error = settings
            .with("control: {populaton: 7}")
            .unwrap_err()
            .to_string();
        assert!(error.contains("populaton"), "{error}");
        assert!(settings.with("7").is_err());
    }
}
