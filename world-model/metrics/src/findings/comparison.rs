//! Comparison of two models over the units measured on both.

use std::collections::{BTreeMap, BTreeSet};

use crate::statistics::{
    Bootstrap, Estimate, Interval, Method, SignFlip, bootstrap_paired_difference, sign_flip_test,
};
use serde::Serialize;
use serde_json::Value;

use crate::findings::{
    Better, FindingsError, Header, Metric, Mismatch, ModelFindings, json::settings,
};

/// Fewest pairs with an interval and a test.
const LEAST_PAIRS: usize = 2;
/// Fewest units for which a bootstrap alone can separate models; the sign-flip test never does with fewer.
const LEAST_UNITS: usize = 6;

/// One-sided level of the test required by a [`Verdict`], beside a 95 % interval with as much on either side.
const LEVEL: f64 = 0.025;

/// A model compared with a baseline.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Header of the baseline.
    pub baseline: Header,
    /// Header of the model.
    pub model: Header,
    /// Figures of both models, by name.
    pub differences: BTreeMap<String, Difference>,
    /// Figures without a comparison, by name, with the reason.
    pub absent: BTreeMap<String, String>,
}

/// A figure of a model against the baseline's.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Value of the baseline.
    pub baseline: f64,
    /// Value of the model.
    pub value: f64,
    /// Model minus baseline: the difference of the means over pairs, or of the figures if they are not means.
    pub difference: f64,
    /// 95 % paired bootstrap interval of the difference.
    pub interval: Option<Interval>,
    /// One-sided p that the model is better: from the sign-flip test, or from the paired bootstrap if the figure is not
    /// a mean over units.
    pub p: Option<f64>,
    /// Whether p is exact rather than estimated by sampling.
    pub p_is_exact: bool,
    /// Pairs: units of the same name.
    pub n: usize,
    /// Better direction.
    pub better: Better,
    /// Unit of the figure.
    pub unit: String,
    /// Verdict on the difference.
    pub verdict: Verdict,
}

/// Verdict on a difference. Except for [`Self::Unclear`], its 95 % interval must exclude 0, and for a mean over units
/// the sign-flip test in its direction must give p of at most 0.025. An interval of few pairs is too narrow, and the
/// test alone ignores the size. Fewer than six pairs never suffice. There is no correction for the number of figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Verdict {
    /// The model is better.
    Better,
    /// The model is worse.
    Worse,
    /// The models differ in a figure without a better direction.
    Differs,
    /// The pairs show no clear difference.
    Unclear,
    /// There are too few pairs.
    Untested,
}

impl Verdict {
    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Better => "better",
            Self::Worse => "worse",
            Self::Differs => "differs",
            Self::Unclear => "no clear difference",
            Self::Untested => "not tested",
        }
    }
}

/// Compares every model but the first with the first.
///
/// # Errors
/// Those of [`compare`].
pub fn compare_with_first(findings: &[ModelFindings]) -> Result<Vec<Comparison>, FindingsError> {
    let Some((baseline, others)) = findings.split_first() else {
        return Ok(Vec::new());
    };
    others
        .iter()
        .map(|model| compare(baseline, model))
        .collect()
}

/// Compares `model` with `baseline`.
///
/// # Errors
/// [`FindingsError::NotComparable`] if the data's digest, the seed or the settings differ;
/// [`FindingsError::Statistics`] if the samples of a figure have no interval.
pub fn compare(
    baseline: &ModelFindings,
    model: &ModelFindings,
) -> Result<Comparison, FindingsError> {
    require_comparable(&baseline.header, &model.header)?;
    let (ours, theirs) = (baseline.metrics(), model.metrics());
    let names: BTreeSet<&str> = ours.keys().chain(theirs.keys()).copied().collect();
    let (mut differences, mut absent) = (BTreeMap::new(), BTreeMap::new());
    for name in names {
        let why = match (ours.get(name), theirs.get(name)) {
            (Some(a), Some(b)) if !(b.value - a.value).is_finite() => {
                "the difference is not finite".to_owned()
            }
            (Some(a), Some(b)) if a.unit == b.unit && a.better == b.better => {
                let difference = difference(name, a, b, baseline.header.seed)?;
                differences.insert(name.to_owned(), difference);
                continue;
            }
            (Some(a), Some(b)) if a.unit != b.unit => {
                format!("in {:?} and in {:?}", a.unit, b.unit)
            }
            (Some(_), Some(_)) => "better in different directions".to_owned(),
            (Some(_), None) => format!("not measured for {}", model.header.model),
            _ => format!("not measured for {}", baseline.header.model),
        };
        absent.insert(name.to_owned(), why);
    }
    Ok(Comparison {
        baseline: baseline.header.clone(),
        model: model.header.clone(),
        differences,
        absent,
    })
}

/// Rejects other data, another seed or other settings.
pub(crate) fn require_comparable(baseline: &Header, model: &Header) -> Result<(), FindingsError> {
    let mismatches = mismatches(baseline, model);
    if mismatches.is_empty() {
        return Ok(());
    }
    Err(FindingsError::NotComparable {
        baseline: baseline.model.clone(),
        model: model.model.clone(),
        mismatches,
    })
}

fn difference(name: &str, a: &Metric, b: &Metric, seed: u64) -> Result<Difference, FindingsError> {
    let pairs = a.samples.iter().filter_map(|(unit, a)| {
        let b = b.samples.get(unit)?;
        (b - a).is_finite().then_some((*b, *a))
    });
    let (theirs, ours): (Vec<f64>, Vec<f64>) = pairs.unzip();
    let plain = Difference {
        baseline: a.value,
        value: b.value,
        difference: b.value - a.value,
        interval: None,
        p: None,
        p_is_exact: false,
        n: theirs.len(),
        better: a.better,
        unit: a.unit.clone(),
        verdict: Verdict::Untested,
    };
    let statistics = |source| FindingsError::Statistics {
        metric: name.to_owned(),
        source,
    };
    let settings = Bootstrap {
        seed,
        ..Bootstrap::default()
    };
    let estimate = match paired_replicates(a, b) {
        Some(differences) => Estimate::of_replicates(plain.difference, differences, settings.level),
        None if plain.n >= LEAST_PAIRS => bootstrap_paired_difference(&theirs, &ours, &settings),
        None => return Ok(plain),
    };
    let estimate = estimate.map_err(statistics)?;
    let flips = SignFlip {
        seed,
        ..SignFlip::default()
    };
    // p for this sign of the difference, and whether it is exact.
    let test = |sign: f64| -> Result<(f64, bool), FindingsError> {
        if plain.n < LEAST_PAIRS {
            let share = estimate.not_above_zero;
            return Ok((if sign > 0.0 { share } else { 1.0 - share }, false));
        }
        let pairs = theirs.iter().zip(&ours);
        let signed: Vec<f64> = pairs.map(|(b, a)| sign * (b - a)).collect();
        let test = sign_flip_test(&signed, &flips).map_err(statistics)?;
        let is_exact = matches!(test.method, Method::Convolved | Method::Enumerated);
        Ok((test.p, is_exact))
    };
    let (more, less) = (test(1.0)?, test(-1.0)?);
    let shown = match a.better {
        Better::Higher => Some(more),
        Better::Lower => Some(less),
        Better::Neither => None,
    };
    let n = if plain.n < LEAST_PAIRS { a.n } else { plain.n };
    let above = estimate.interval.low > 0.0 && more.0 <= LEVEL;
    let below = estimate.interval.high < 0.0 && less.0 <= LEVEL;
    let verdict = match (a.better, above, below) {
        // With a bootstrap alone, require as many units as the sign-flip test would.
        _ if n < LEAST_UNITS && plain.n < LEAST_PAIRS => Verdict::Untested,
        (_, false, false) => Verdict::Unclear,
        (Better::Neither, ..) => Verdict::Differs,
        (Better::Higher, true, _) | (Better::Lower, false, _) => Verdict::Better,
        _ => Verdict::Worse,
    };
    Ok(Difference {
        difference: estimate.value,
        interval: Some(estimate.interval),
        p: shown.map(|(p, _)| p),
        p_is_exact: shown.is_some_and(|(_, is_exact)| is_exact),
        n,
        verdict,
        ..plain
    })
}

/// Replicates of the difference, if both figures have replicates of the same draws.
fn paired_replicates(a: &Metric, b: &Metric) -> Option<Vec<f64>> {
    let count = a.replicates.len();
    if count < 2 || count != b.replicates.len() || a.n != b.n {
        return None;
    }
    let pairs = b.replicates.iter().zip(&a.replicates);
    Some(pairs.map(|(b, a)| b - a).collect())
}

/// All settings that must be equal but differ.
fn mismatches(baseline: &Header, model: &Header) -> Vec<Mismatch> {
    let mut found = Vec::new();
    let mut check = |what: &str, baseline: String, model: String| {
        if baseline != model {
            found.push(Mismatch {
                what: what.to_owned(),
                baseline,
                model,
            });
        }
    };
    check(
        "data",
        baseline.data_digest.clone(),
        model.data_digest.clone(),
    );
    check("seed", baseline.seed.to_string(), model.seed.to_string());
    let (ours, theirs) = (leaves(&baseline.settings), leaves(&model.settings));
    let paths: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
    for path in paths {
        let describe = |leaves: &BTreeMap<String, String>| {
            let leaf = leaves.get(path).cloned();
            leaf.unwrap_or_else(|| "not set".to_owned())
        };
        check(path, describe(&ours), describe(&theirs));
    }
    found
}

/// All values of the settings, by path. 1 and 1.0 are equal.
fn leaves(value: &Value) -> BTreeMap<String, String> {
    fn visit(path: String, value: &Value, into: &mut BTreeMap<String, String>) {
        match value {
            Value::Object(entries) if !entries.is_empty() => {
                for (name, value) in entries {
                    visit(format!("{path}.{name}"), value, into);
                }
            }
            Value::Number(number) => {
                // Below 2^53, a float without fraction is an exact integer.
                let whole = number
                    .as_f64()
                    .filter(|float| float.fract() == 0.0 && float.abs() < 9e15);
                into.insert(
                    path,
                    whole.map_or_else(|| number.to_string(), |whole| format!("{whole:.0}")),
                );
            }
            other => {
                into.insert(path, settings(other));
            }
        }
    }
    let mut into = BTreeMap::new();
    visit("settings".to_owned(), value, &mut into);
    into
}
