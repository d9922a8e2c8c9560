use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

use super::{EpisodeFigure, FeatureSpace, Vectors};

/// What networks say of one rollout. A figure that is in neither of the maps has no network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EpisodePerception {
    /// Figures of the rollout alone.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<EpisodeFigure, Values>,
    /// Features, for figures of all rollouts together.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<FeatureSpace, Of<Vectors>>,
    /// Why there is no figure though there is a network, by the name of the figure or of the features.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub lacking: BTreeMap<String, String>,
}

/// The values of a figure: one a step, or one of the whole rollout.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Values {
    /// Of the decoded predictions.
    pub predicted: Vec<f64>,
    /// Of the frames that were encoded and decoded; empty where the figure has no ceiling.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reconstructed: Vec<f64>,
}

/// Something of what came, of the decoded predictions, and of the frames that were encoded and decoded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Of<T> {
    /// Of what came.
    pub truth: T,
    /// Of the decoded predictions.
    pub predicted: T,
    /// Of the frames that were encoded and decoded.
    pub reconstructed: T,
}

impl EpisodePerception {
    /// Whether there was no network.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.figures.is_empty() && self.features.is_empty() && self.lacking.is_empty()
    }

    /// Keeps what was found, or why there is nothing.
    pub(super) fn keep(&mut self, figure: EpisodeFigure, found: Result<Values, impl fmt::Display>) {
        match found {
            Ok(values) => {
                self.figures.insert(figure, values);
            }
            Err(why) => self.lack(figure.name(), why.to_string()),
        }
    }

    /// Says why there is nothing.
    pub(super) fn lack(&mut self, name: &str, why: String) {
        self.lacking.insert(name.to_owned(), why);
    }
}

impl Values {
    /// Those of a figure without a ceiling.
    #[must_use]
    pub fn of(predicted: Vec<f64>) -> Self {
        Self {
            predicted,
            reconstructed: Vec::new(),
        }
    }
}
