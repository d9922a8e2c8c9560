//! How much is measured, and how.

use anyhow::{Result, ensure};
use clap::ValueEnum;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;

use crate::policy::{PolicyInputs, PolicySettings};

/// How much is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// A few minutes with a small model on two cores: fewer episodes and windows, otherwise as the paper.
    #[default]
    Quick,
    /// The paper's numbers of episodes, windows and steps (appendix C).
    Paper,
}

/// The settings of all suites. They are part of the results: only equal ones are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of everything that is drawn: noise, candidates, random guesses, resamples.
    pub seed: u64,
    /// Resamples of a bootstrap.
    pub resamples: usize,
    /// See [`FidelitySettings`].
    pub fidelity: FidelitySettings,
    /// See [`ControlSettings`].
    pub control: ControlSettings,
    /// See [`LatentsSettings`].
    pub latents: LatentsSettings,
    /// See [`RobustnessSettings`].
    pub robustness: RobustnessSettings,
    /// See [`PolicySettings`].
    pub policy: PolicySettings,
    /// The user's networks, as [`Perception::description`](crate::Perception::description) has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub networks: Option<Value>,
}

/// Decoded rollouts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FidelitySettings {
    /// Episodes at most, spread over all.
    pub episodes: usize,
    /// Predicted steps at most; an episode's rollout ends with the episode.
    pub steps: usize,
    /// Rollouts that the report shows.
    pub strips: usize,
}

/// Planning, and the response to actions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControlSettings {
    /// The searches.
    pub searches: Vec<SearchSettings>,
    /// Candidates of an iteration.
    pub population: usize,
    /// Iterations of a search.
    pub iterations: usize,
    /// Candidates that the next Gaussian is fitted to.
    pub elites: usize,
    /// Candidates are clamped to plus and minus this, in model units.
    pub bound: f32,
    /// First standard deviation as a share of that range.
    pub initial_std: f32,
    /// Windows at most in which the response to right and wrong actions is measured.
    pub response_windows: usize,
    /// Predicted steps of these.
    pub response_steps: usize,
}

/// Searches of one number of steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchSettings {
    /// Steps k that are searched together.
    pub k: usize,
    /// Windows at most in which they are, spread over all.
    pub windows: usize,
}

/// Action recovery and success.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LatentsSettings {
    /// Windows at most from which actions are told, spread over all.
    pub windows: usize,
    /// Predicted steps of these, where the inverse dynamics model needs no more.
    pub steps: usize,
    /// Episodes with an instruction and an outcome at most, spread over all.
    pub judged_episodes: usize,
}

/// Changed frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobustnessSettings {
    /// Windows at most, spread over all.
    pub windows: usize,
    /// Predicted steps.
    pub steps: usize,
}

impl Settings {
    /// These, but for what `text` (YAML or JSON) names.
    ///
    /// # Errors
    /// If it names what is no setting, or gives a value of another kind.
    pub fn with(&self, text: &str) -> Result<Self> {
        changed(self, text)
    }

    /// As YAML, which [`Self::with`] reads.
    ///
    /// # Errors
    /// None that is known of: numbers and names have a form in YAML.
    pub fn to_yaml(&self) -> Result<String> {
        Ok(serde_yaml_ng::to_string(self)?)
    }

    /// Those of a model card: what takes seconds, so no searches.
    #[must_use]
    pub fn brief(seed: u64) -> Self {
        let mut settings = Self::of(Protocol::Quick, seed);
        settings.fidelity.episodes = 8;
        settings.fidelity.steps = 8;
        settings.control.searches.clear();
        settings.control.response_windows = 16;
        settings.latents.windows = 16;
        settings.latents.judged_episodes = 16;
        settings
    }

    /// Those of a protocol.
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

/// Replaces what `changes` names, at any depth.
/// `settings` with those of a YAML text in their place.
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
    fn what_is_named_changes_and_a_typo_is_refused() {
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
