//! Findings of one model.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::findings::{AbsentFigure, Metric, Section, Suite};

/// All findings of one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFindings {
    /// Data and settings of the evaluation.
    pub header: Header,
    /// Sections in the order of [`Suite::ALL`].
    pub sections: Vec<Section>,
}

/// Data and settings of an evaluation. Results are comparable if all but the model agree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Name by which the model was opened.
    pub model: String,
    /// Lower-case hex SHA-256 of its weights and their use.
    pub hash: String,
    /// Name of its latent space.
    pub space: String,
    /// Paths of the data, as given.
    pub data: Vec<String>,
    /// Lower-case hex SHA-256 of the data.
    pub data_digest: String,
    /// Number of episodes.
    pub episodes: usize,
    /// Excluded parts of the data, with reasons.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Settings of the suites.
    pub settings: serde_json::Value,
    /// Sampler settings, a property of the model that may differ between compared models.
    pub sampler: serde_json::Value,
    /// Lower-case hex SHA-256 of inverse dynamics models and success probes, by the prefix of their figures.
    #[serde(default)]
    pub readers: BTreeMap<String, String>,
    /// Version of this program.
    pub version: String,
}

impl Header {
    /// A header with the model only, without data.
    #[must_use]
    pub fn of(model: &str, hash: &str, space: &str) -> Self {
        Self {
            model: model.to_owned(),
            hash: hash.to_owned(),
            space: space.to_owned(),
            data: Vec::new(),
            data_digest: String::new(),
            episodes: 0,
            left_out: Vec::new(),
            seed: 0,
            settings: serde_json::Value::Null,
            sampler: serde_json::Value::Null,
            readers: BTreeMap::new(),
            version: String::new(),
        }
    }
}

impl ModelFindings {
    /// All finite figures, by name; [`Self::absent`] has the others.
    #[must_use]
    pub fn metrics(&self) -> BTreeMap<&str, &Metric> {
        let metrics = self.sections.iter().flat_map(|section| &section.metrics);
        metrics
            .filter(|(_, metric)| metric.value.is_finite())
            .map(|(name, metric)| (name.as_str(), metric))
            .collect()
    }

    /// Missing figures by name, with the joined reasons.
    #[must_use]
    pub fn absent(&self) -> BTreeMap<&str, String> {
        absent(self.sections.iter())
    }

    /// Missing figures of one suite.
    pub(crate) fn absent_of(&self, suite: Suite) -> BTreeMap<&str, String> {
        absent(self.of(suite))
    }

    /// Sections of a suite: none, one, or several parts.
    pub(crate) fn of(&self, suite: Suite) -> impl Iterator<Item = &Section> {
        let sections = self.sections.iter();
        sections.filter(move |section| section.suite == suite)
    }
}

impl Header {
    /// The first eight digits of the hash, which suffice within a report.
    #[must_use]
    pub fn short_hash(&self) -> String {
        self.hash.chars().take(8).collect()
    }
}

fn absent<'a>(sections: impl Iterator<Item = &'a Section>) -> BTreeMap<&'a str, String> {
    let mut absent: BTreeMap<&str, String> = BTreeMap::new();
    let mut add = |name, why: String| {
        absent
            .entry(name)
            .and_modify(|before| {
                before.push_str("; ");
                before.push_str(&why);
            })
            .or_insert(why);
    };
    for section in sections {
        for AbsentFigure { metric, why } in &section.absent {
            add(metric, why.clone());
        }
        for (name, metric) in &section.metrics {
            if !metric.value.is_finite() {
                add(name, format!("the value is not finite ({})", metric.value));
            }
        }
    }
    absent
}
