//! What a suite found: figures, and what a report shows of them.

use std::collections::BTreeMap;

use crate::statistics::Interval;
use serde::{Deserialize, Serialize};

use crate::findings::Suite;

/// The findings of one suite about one model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Section {
    /// The suite.
    pub suite: Suite,
    /// Figures by name, as `control.cem_k1_error`.
    pub metrics: BTreeMap<String, Metric>,
    /// What was not measured, and why.
    pub absent: Vec<Absent>,
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
    /// 95 % bootstrap interval over the units; `None` where there are too few, or it was not asked for.
    pub interval: Option<Interval>,
    /// Units that it is of.
    pub n: usize,
    /// Which way is better.
    pub better: Better,
    /// Unit of the value, empty for a plain number.
    pub unit: String,
    /// What it says, in a sentence.
    pub about: String,
    /// The value of every unit by the unit's name, for paired comparisons of models; empty where there are none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub samples: BTreeMap<String, f64>,
    /// Of a figure that is no mean over units, its value in every bootstrap resample: those of two models over the same units
    /// are of the same draws ([`crate::statistics::replicates`]). Empty where there are none.
    #[serde(skip)]
    pub replicates: Vec<f64>,
}

/// Which way a figure is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// More is better.
    Higher,
    /// Less is better.
    Lower,
    /// It depends.
    Neither,
}

/// Something that was not measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Absent {
    /// The metric's name.
    pub metric: String,
    /// Why, and what it would take.
    pub why: String,
}

/// Values over an axis, a line for each series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// What it shows.
    pub title: String,
    /// The axis.
    pub x: String,
    /// The values, with their unit.
    pub y: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// A line of a [`Curve`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// What it is of.
    pub name: String,
    /// (x, y).
    pub points: Vec<[f64; 2]>,
    /// Low and high at each point; empty where there is no band.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub band: Vec<[f64; 2]>,
}

/// Rows of text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextTable {
    /// What it shows.
    pub title: String,
    /// Over the columns.
    pub header: Vec<String>,
    /// The rows, each as long as the header.
    pub rows: Vec<Vec<String>>,
}

/// Paths in a plane, of episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trajectories {
    /// What it shows.
    pub title: String,
    /// What stands below it.
    pub caption: String,
    /// The points of each.
    pub paths: Vec<Vec<[f64; 2]>>,
}

/// A picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// What it shows.
    pub caption: String,
    /// A PNG in base64.
    pub png: String,
}

impl Better {
    /// As in JSON and CSV.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Higher => "higher",
            Self::Lower => "lower",
            Self::Neither => "neither",
        }
    }

    /// An arrow; empty where it depends.
    pub(crate) fn arrow(self) -> &'static str {
        match self {
            Self::Higher => "↑",
            Self::Lower => "↓",
            Self::Neither => "",
        }
    }

    /// What the arrow says.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Higher => "more is better",
            Self::Lower => "less is better",
            Self::Neither => "",
        }
    }
}

impl Section {
    /// One without findings.
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

    /// Adds a figure; `name` without the suite's.
    pub fn metric(&mut self, name: &str, metric: Metric) {
        self.metrics
            .insert(format!("{}.{name}", self.suite.name()), metric);
    }

    /// Says that a figure was not measured; `name` without the suite's.
    pub fn absent(&mut self, name: &str, why: impl Into<String>) {
        self.absent.push(Absent {
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

    /// The interval, where both ends are finite.
    #[must_use]
    pub fn finite_interval(&self) -> Option<Interval> {
        self.interval
            .filter(|interval| interval.low.is_finite() && interval.high.is_finite())
    }

    /// The same in a unit.
    #[must_use]
    pub fn in_unit(self, unit: &str) -> Self {
        Self {
            unit: unit.to_owned(),
            ..self
        }
    }
}
