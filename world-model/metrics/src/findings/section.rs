//! Findings of a suite, and the contents of its report.

use std::collections::BTreeMap;

use crate::statistics::Interval;
use serde::{Deserialize, Serialize};

use crate::findings::Suite;

/// Findings of one suite for one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// The suite.
    pub suite: Suite,
    /// Figures by name, such as `control.cem_k1_error`.
    pub metrics: BTreeMap<String, Metric>,
    /// Missing figures, with reasons.
    pub absent: Vec<AbsentFigure>,
    /// Remarks on how something was measured.
    pub notes: Vec<String>,
    /// Values over an axis.
    pub curves: Vec<Curve>,
    /// Rows of text.
    pub tables: Vec<TextTable>,
    /// Paths in a plane.
    pub trajectories: Vec<Trajectories>,
    /// Pictures.
    pub pictures: Vec<Picture>,
}

/// A figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// The value.
    pub value: f64,
    /// 95 % bootstrap interval over the units; `None` if there are too few, or it was not requested.
    pub interval: Option<Interval>,
    /// Number of units.
    pub n: usize,
    /// Better direction.
    pub better: Better,
    /// Unit of the value, empty for a plain number.
    pub unit: String,
    /// Meaning, in a sentence.
    pub about: String,
    /// Value of each unit by name, for paired comparisons; empty if unknown.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub samples: BTreeMap<String, f64>,
    /// For a figure that is not a mean over units, its value in every bootstrap resample. Two models over the same
    /// units use the same draws ([`crate::statistics::replicates`]). Empty if unknown.
    #[serde(skip)]
    pub replicates: Vec<f64>,
}

/// Better direction of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Higher is better.
    Higher,
    /// Lower is better.
    Lower,
    /// Neither direction is better.
    Neither,
}

/// A missing figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AbsentFigure {
    /// Name of the figure.
    pub metric: String,
    /// Reason, and what it needs.
    pub why: String,
}

/// Values over an axis, with a line per series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Title.
    pub title: String,
    /// Name of the axis.
    pub x: String,
    /// Name of the values, with their unit.
    pub y: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// A line of a [`Curve`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Name.
    pub name: String,
    /// (x, y).
    pub points: Vec<[f64; 2]>,
    /// Low and high at each point; empty without a band.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub band: Vec<[f64; 2]>,
}

/// Rows of text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextTable {
    /// Title.
    pub title: String,
    /// Column names.
    pub header: Vec<String>,
    /// The rows, each as long as the header.
    pub rows: Vec<Vec<String>>,
}

/// Paths of episodes in a plane.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trajectories {
    /// Title.
    pub title: String,
    /// Text below the paths.
    pub caption: String,
    /// Points of each path.
    pub paths: Vec<Vec<[f64; 2]>>,
}

/// A picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Text below the picture.
    pub caption: String,
    /// A PNG in base64.
    pub png: String,
}

impl Better {
    /// Name in JSON and CSV.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Higher => "higher",
            Self::Lower => "lower",
            Self::Neither => "neither",
        }
    }

    /// An arrow; empty for neither direction.
    pub(crate) fn arrow(self) -> &'static str {
        match self {
            Self::Higher => "↑",
            Self::Lower => "↓",
            Self::Neither => "",
        }
    }

    /// The arrow in words.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Higher => "higher is better",
            Self::Lower => "lower is better",
            Self::Neither => "",
        }
    }
}

impl Section {
    /// A section without findings.
    #[must_use]
    pub fn new(suite: Suite) -> Self {
        Self {
            suite,
            metrics: BTreeMap::new(),
            absent: Vec::new(),
            notes: Vec::new(),
            curves: Vec::new(),
            tables: Vec::new(),
            trajectories: Vec::new(),
            pictures: Vec::new(),
        }
    }

    /// Adds a figure; `name` without the suite.
    pub fn metric(&mut self, name: &str, metric: Metric) {
        self.metrics
            .insert(format!("{}.{name}", self.suite.name()), metric);
    }

    /// Reports a missing figure; `name` without the suite.
    pub fn absent(&mut self, name: &str, why: impl Into<String>) {
        self.absent.push(AbsentFigure {
            metric: format!("{}.{name}", self.suite.name()),
            why: why.into(),
        });
    }
}

impl Metric {
    /// A figure without an interval.
    #[must_use]
    pub fn plain(value: f64, n: usize, better: Better, about: &str) -> Self {
        Self {
            value,
            interval: None,
            n,
            better,
            unit: String::new(),
            about: about.to_owned(),
            samples: BTreeMap::new(),
            replicates: Vec::new(),
        }
    }

    /// The interval, if both ends are finite.
    #[must_use]
    pub fn finite_interval(&self) -> Option<Interval> {
        self.interval
            .filter(|interval| interval.low.is_finite() && interval.high.is_finite())
    }

    /// Sets the unit.
    #[must_use]
    pub fn in_unit(self, unit: &str) -> Self {
        Self {
            unit: unit.to_owned(),
            ..self
        }
    }
}
