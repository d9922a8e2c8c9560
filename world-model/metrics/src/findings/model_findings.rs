//! What was found about one model.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::findings::{Absent, Metric, Section, Suite};

/// All findings about one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFindings {
    /// What it was measured on and how.
    pub header: Header,
    /// The suites, in the order of [`crate::findings::Suite::ALL`].
    pub sections: Vec<Section>,
}

/// What was measured on what, and how: two results are comparable if all but the model agrees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// By which the model was opened.
    pub model: String,
    /// Lower-case hex SHA-256 of its weights and of how they are used.
    pub hash: String,
    /// Its latent space.
    pub space: String,
    /// Paths of the data, as given.
    pub data: Vec<String>,
    /// Lower-case hex SHA-256 of the data.
    pub data_digest: String,
    /// Episodes measured on.
    pub episodes: usize,
    /// What of the data was left out, and why.
    #[serde(default)]
    pub left_out: Vec<String>,
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// The settings of the suites.
    pub settings: serde_json::Value,
    /// How frames are sampled: a property of the model, in which models that are compared may differ.
    pub sampler: serde_json::Value,
    /// Lower-case hex SHA-256 of the inverse dynamics models and success probes, by the names that their figures begin with.
    #[serde(default)]
    pub readers: BTreeMap<String, String>,
    /// Version of this program.
    pub version: String,
}

impl Header {
    /// One that says which model, and nothing of data.
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
    /// All figures by name; without those that are not finite, which [`Self::absent`] has.
    #[must_use]
    pub fn metrics(&self) -> BTreeMap<&str, &Metric> {
        let metrics = self.sections.iter().flat_map(|section| &section.metrics);
        metrics
            .filter(|(_, metric)| metric.value.is_finite())
            .map(|(name, metric)| (name.as_str(), metric))
            .collect()
    }

    /// All that was not measured, by name, with the reason; where one has several, joined.
    #[must_use]
    pub fn absent(&self) -> BTreeMap<&str, String> {
        absent(self.sections.iter())
    }

    /// What was not measured of one suite.
    pub(crate) fn absent_of(&self, suite: Suite) -> BTreeMap<&str, String> {
        absent(self.of(suite))
    }

    /// The findings of a suite: none, one section, or the parts that it was measured in.
    pub(crate) fn of(&self, suite: Suite) -> impl Iterator<Item = &Section> {
        let sections = self.sections.iter();
        sections.filter(move |section| section.suite == suite)
    }
}

impl Header {
    /// The first eight digits of the hash: enough to tell models of one report apart.
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
        for Absent { metric, why } in &section.absent {
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
