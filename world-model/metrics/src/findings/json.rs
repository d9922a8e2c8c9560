//! Findings as JSON.

use std::collections::BTreeMap;

use crate::statistics::Interval;
use serde::{Serialize, Serializer};
use serde_json::Value;

use crate::findings::{
    Better, Comparison, Difference, FindingsError, Header, ModelFindings, Verdict,
    compare_with_first,
};

/// Of one model an object; of several (or none) `{"models": [...], "comparisons": [...]}`, each compared with the first.
/// Indented, with a newline at its end, and equal bytes for equal findings: keys stand in a fixed order or sorted, and
/// zero has no sign. The values of single units are not in it.
///
/// # Errors
/// Those of [`compare`](crate::findings::compare()) for several.
pub fn json(findings: &[ModelFindings]) -> Result<String, FindingsError> {
    let mut text = if let [one] = findings {
        serde_json::to_string_pretty(&model(one))?
    } else {
        let comparisons = compare_with_first(findings)?;
        serde_json::to_string_pretty(&Models {
            models: findings.iter().map(model).collect(),
            comparisons: comparisons.iter().map(comparison).collect(),
        })?
    };
    text.push('\n');
    Ok(text)
}

#[derive(Serialize)]
struct Models<'a> {
    models: Vec<Model<'a>>,
    comparisons: Vec<Compared<'a>>,
}

#[derive(Serialize)]
struct Model<'a> {
    model: &'a str,
    hash: &'a str,
    seed: u64,
    space: &'a str,
    data: &'a [String],
    data_digest: &'a str,
    episodes: usize,
    left_out: &'a [String],
    version: &'a str,
    settings: Sorted<'a>,
    sampler: Sorted<'a>,
    readers: &'a BTreeMap<String, String>,
    metrics: BTreeMap<&'a str, Figure<'a>>,
    absent: BTreeMap<&'a str, String>,
}

#[derive(Serialize)]
struct Figure<'a> {
    value: f64,
    interval: Option<[f64; 2]>,
    n: usize,
    unit: &'a str,
    better: Better,
}

#[derive(Serialize)]
struct Compared<'a> {
    baseline: Named,
    model: Named,
    metrics: BTreeMap<&'a str, Differing<'a>>,
    absent: &'a BTreeMap<String, String>,
}

#[derive(Serialize)]
struct Named {
    model: String,
    hash: String,
}

#[derive(Serialize)]
struct Differing<'a> {
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

/// Whatever the order that objects came in: whether `serde_json` keeps it depends on what else is built.
struct Sorted<'a>(&'a Value);

impl Serialize for Sorted<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            Value::Object(entries) => {
                let sorted: BTreeMap<_, _> = entries.iter().map(|(k, v)| (k, Sorted(v))).collect();
                serializer.collect_map(sorted)
            }
            Value::Array(values) => serializer.collect_seq(values.iter().map(Sorted)),
            other => other.serialize(serializer),
        }
    }
}

/// Settings as they are shown: sorted and indented.
pub(crate) fn settings(settings: &Value) -> String {
    serde_json::to_string_pretty(&Sorted(settings)).unwrap_or_else(|error| error.to_string())
}

/// Without the sign of zero.
fn unsigned_zero(value: f64) -> f64 {
    value + 0.0
}

fn ends(interval: Option<Interval>) -> Option<[f64; 2]> {
    interval.map(|interval| [interval.low, interval.high].map(unsigned_zero))
}

fn model(findings: &ModelFindings) -> Model<'_> {
    let header = &findings.header;
    let metrics = findings.metrics().into_iter();
    Model {
        model: &header.model,
        hash: &header.hash,
        seed: header.seed,
        space: &header.space,
        data: &header.data,
        data_digest: &header.data_digest,
        episodes: header.episodes,
        left_out: &header.left_out,
        version: &header.version,
        settings: Sorted(&header.settings),
        sampler: Sorted(&header.sampler),
        readers: &header.readers,
        metrics: metrics
            .map(|(name, metric)| {
                let figure = Figure {
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

fn comparison(comparison: &Comparison) -> Compared<'_> {
    let named = |header: &Header| Named {
        model: header.model.clone(),
        hash: header.hash.clone(),
    };
    let differences = comparison.differences.iter();
    Compared {
        baseline: named(&comparison.baseline),
        model: named(&comparison.model),
        metrics: differences
            .map(|(name, difference)| (name.as_str(), differing(difference)))
            .collect(),
        absent: &comparison.absent,
    }
}

fn differing(difference: &Difference) -> Differing<'_> {
    Differing {
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
