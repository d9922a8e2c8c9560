use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

use super::{EpisodeFigure, FeatureSpace, Vectors};

/// Metrics of one rollout by networks. A figure in neither map has no network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct EpisodePerception {
    /// Figures of the rollout alone.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub figures: BTreeMap<EpisodeFigure, Values>,
    /// Features, for figures of all rollouts together.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub features: BTreeMap<FeatureSpace, BySource<Vectors>>,
    /// Reasons for missing results of a network, by figure or features.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub lacking: BTreeMap<String, String>,
}

/// Values of a figure: one per step, or one for the rollout.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Values {
    /// Of the decoded predictions.
    pub predicted: Vec<f64>,
    /// Of the reconstructions; empty if the figure has no ceiling.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reconstructed: Vec<f64>,
}

/// Values for true frames, decoded predictions and reconstructions (encoded and decoded).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BySource<T> {
    /// Of the true frames.
    pub truth: T,
    /// Of the decoded predictions.
    pub predicted: T,
    /// Of the reconstructions.
    pub reconstructed: T,
}

impl EpisodePerception {
    /// Whether there was no network.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.figures.is_empty() && self.features.is_empty() && self.lacking.is_empty()
    }

    /// Stores a result, or the reason for its absence.
    pub(super) fn keep(&mut self, figure: EpisodeFigure, found: Result<Values, impl fmt::Display>) {
        match found {
            Ok(values) => {
                self.figures.insert(figure, values);
            }
            Err(why) => self.lack(figure.name(), why.to_string()),
        }
    }

    /// Stores the reason for a missing result.
    pub(super) fn lack(&mut self, name: &str, why: String) {
        self.lacking.insert(name.to_owned(), why);
    }
}

impl Values {
    /// Values of a figure without a ceiling.
    #[must_use]
    pub fn of(predicted: Vec<f64>) -> Self {
        Self {
            predicted,
            reconstructed: Vec::new(),
        }
    }
}
