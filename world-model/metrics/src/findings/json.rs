//! Findings as JSON.

use std::collections::BTreeMap;

use crate::statistics::Interval;
use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::findings::{
    Better, Comparison, Difference, FindingsError, Header, ModelFindings, Verdict,
    compare_with_first,
};

/// An object for one model; `{"models": [...], "comparisons": [...]}` for several (or none), each compared with the
/// first. Indented, with a final newline. Equal findings give equal bytes: keys have a fixed order, zero has no sign.
/// Values of single units are not included.
///
/// # Errors
/// Those of [`compare`](crate::findings::compare()) for several models.
pub fn json(findings: &[ModelFindings]) -> Result<String, FindingsError> {
    let mut text = if let [one] = findings {
        serde_json::to_string_pretty(&model(one))?
    } else {
        let comparisons = compare_with_first(findings)?;
        serde_json::to_string_pretty(&ModelsJson {
            models: findings.iter().map(model).collect(),
            comparisons: comparisons.iter().map(comparison).collect(),
        })?
    };
    text.push('\n');
    Ok(text)
}

#[derive(Serialize)]
struct ModelsJson<'a> {
    models: Vec<ModelJson<'a>>,
    comparisons: Vec<ComparisonJson<'a>>,
}

#[derive(Serialize)]
struct ModelJson<'a> {
    model: &'a str,
    hash: &'a str,
    seed: u64,
    space: &'a str,
    data: &'a [String],
    data_digest: &'a str,
    episodes: usize,
    left_out: &'a [String],
    version: &'a str,
    settings: SortedValue<'a>,
    sampler: SortedValue<'a>,
    readers: &'a BTreeMap<String, String>,
    metrics: BTreeMap<&'a str, FigureJson<'a>>,
    absent: BTreeMap<&'a str, String>,
}

#[derive(Serialize)]
struct FigureJson<'a> {
    value: f64,
    interval: Option<[f64; 2]>,
    n: usize,
    unit: &'a str,
    better: Better,
}

#[derive(Serialize)]
struct ComparisonJson<'a> {
    baseline: ModelId,
    model: ModelId,
    metrics: BTreeMap<&'a str, DifferenceJson<'a>>,
    absent: &'a BTreeMap<String, String>,
}

#[derive(Serialize)]
struct ModelId {
    model: String,
    hash: String,
}

#[derive(Serialize)]
struct DifferenceJson<'a> {
    baseline: f64,
    value: f64,
    difference: f64,
    interval: Option<[f64; 2]>,
    p: Option<f64>,
    p_is_exact: Option<bool>,
    n: usize,
    unit: &'a str,
    better: Better,
    verdict: Verdict,
}

/// A value with sorted keys: the order in `serde_json` depends on the features of other crates.
struct SortedValue<'a>(&'a Value);

impl Serialize for SortedValue<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Value::Object(entries) => {
                let sorted: BTreeMap<_, _> =
                    entries.iter().map(|(k, v)| (k, SortedValue(v))).collect();
                serializer.collect_map(sorted)
            }
            Value::Array(values) => serializer.collect_seq(values.iter().map(SortedValue)),
            other => other.serialize(serializer),
        }
    }
}

/// Settings for display: sorted and indented.
pub(crate) fn settings(settings: &Value) -> String {
    serde_json::to_string_pretty(&SortedValue(settings)).unwrap_or_else(|error| error.to_string())
}

fn unsigned_zero(value: f64) -> f64 {
    value + 0.0
}

fn ends(interval: Option<Interval>) -> Option<[f64; 2]> {
    interval.map(|interval| [interval.low, interval.high].map(unsigned_zero))
}

fn model(findings: &ModelFindings) -> ModelJson<'_> {
    let header = &findings.header;
    let metrics = findings.metrics().into_iter();
    ModelJson {
        model: &header.model,
        hash: &header.hash,
        seed: header.seed,
        space: &header.space,
        data: &header.data,
        data_digest: &header.data_digest,
        episodes: header.episodes,
        left_out: &header.left_out,
        version: &header.version,
        settings: SortedValue(&header.settings),
        sampler: SortedValue(&header.sampler),
        readers: &header.readers,
        metrics: metrics
            .map(|(name, metric)| {
                let figure = FigureJson {
                    value: unsigned_zero(metric.value),
                    interval: ends(metric.finite_interval()),
                    n: metric.n,
                    unit: &metric.unit,
                    better: metric.better,
                };
                (name, figure)
            })
            .collect(),
        absent: findings.absent(),
    }
}

fn comparison(comparison: &Comparison) -> ComparisonJson<'_> {
    let model_id = |header: &Header| ModelId {
        model: header.model.clone(),
        hash: header.hash.clone(),
    };
    let differences = comparison.differences.iter();
    ComparisonJson {
        baseline: model_id(&comparison.baseline),
        model: model_id(&comparison.model),
        metrics: differences
            .map(|(name, difference)| (name.as_str(), difference_json(difference)))
            .collect(),
        absent: &comparison.absent,
    }
}

fn difference_json(difference: &Difference) -> DifferenceJson<'_> {
    DifferenceJson {
        baseline: unsigned_zero(difference.baseline),
        value: unsigned_zero(difference.value),
        difference: unsigned_zero(difference.difference),
        interval: ends(difference.interval),
        p: difference.p,
        p_is_exact: difference.p.map(|_| difference.p_is_exact),
        n: difference.n,
        unit: &difference.unit,
        better: difference.better,
        verdict: difference.verdict,
    }
}
