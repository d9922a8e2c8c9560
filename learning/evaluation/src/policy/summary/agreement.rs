//! Agreement of judges, and the choice of two for the consensus.

use wm_metrics::classification::{closest_raters, cohen_kappa};
use wm_metrics::findings::{Better, Metric, Section, TextTable};

use super::{
    mean,
    rates::{Score, rated, slug},
};
use crate::{
    Settings,
    policy::{Condition, ImaginedTrial},
};

/// The two judges of the consensus.
pub(super) struct ConsensusPair {
    pub judges: [String; 2],
    /// How they were chosen among more.
    pub remark: Option<String>,
}

/// The only two judges, or the closest two of more over trials scored by all; `None` for fewer than two.
pub(super) fn of(trials: &[&ImaginedTrial], settings: &Settings) -> Option<ConsensusPair> {
    let names = names(settings);
    let [first, second, others @ ..] = &names[..] else {
        return None;
    };
    let two = |a: &str, b: &str| [a.to_owned(), b.to_owned()];
    if others.is_empty() {
        return Some(ConsensusPair {
            judges: two(first, second),
            remark: None,
        });
    }
    let scored = trials
        .iter()
        .filter(|trial| names.iter().all(|name| rated(trial, name).is_some()));
    let scored: Vec<&ImaginedTrial> = scored.copied().collect();
    let raters = names
        .iter()
        .map(|name| scored.iter().filter_map(|trial| rated(trial, name)));
    let raters: Vec<Vec<bool>> = raters.map(Iterator::collect).collect();
    let closest = closest_raters(&raters).ok();
    let chosen = closest.and_then(|c| Some((names.get(c.first)?, names.get(c.second)?, c.kappa)));
    Some(match chosen {
        Some((a, b, kappa)) => ConsensusPair {
            judges: two(a, b),
            remark: Some(format!(
                "The consensus of {} judges is that of {a} and {b}, which agree most: Cohen's kappa {kappa:.3} over the {} \
                 trials scored by all.",
                names.len(),
                scored.len()
            )),
        },
        None => ConsensusPair {
            judges: two(first, second),
            remark: Some(format!(
                "The consensus is that of the first two of {} judges, {first} and {second}: no pair has a kappa to \
                 choose by.",
                names.len()
            )),
        },
    })
}

fn names(settings: &Settings) -> Vec<&str> {
    let judges = settings.policy.inputs.judges.iter();
    judges.map(|judge| &*judge.name).collect()
}

/// Adds tables of judges and pairs, and the kappas.
pub(super) fn add(
    section: &mut Section,
    trials: &[&ImaginedTrial],
    settings: &Settings,
    agreed: Option<&ConsensusPair>,
) {
    let names = names(settings);
    if names.is_empty() {
        return;
    }
    let is_chosen =
        |name: &str| agreed.is_some_and(|agreed| agreed.judges.iter().any(|j| j == name));
    let mark = |is: bool| if is { "yes" } else { "" }.to_owned();
    let judges = settings.policy.inputs.judges.iter().map(|judge| {
        let score = Score {
            name: String::new(),
            title: String::new(),
            about: String::new(),
            is_rate: true,
            of: Box::new(|trial| rated(trial, &judge.name).map(f64::from)),
        };
        let recorded = trials
            .iter()
            .copied()
            .filter(|trial| trial.condition == Condition::Recorded);
        let all = recorded.clone().count();
        let (rate, n) = mean(recorded, &score).map_or((f64::NAN, 0), |found| found);
        let error = (rate * (1.0 - rate) / n as f64).sqrt();
        let format_value = |value: f64| {
            if value.is_finite() {
                format!("{value:.3}")
            } else {
                "-".into()
            }
        };
        vec![
            judge.name.clone(),
            judge.model.clone(),
            format_value(rate),
            format_value(error),
            n.to_string(),
            (all - n).to_string(),
            mark(is_chosen(&judge.name)),
        ]
    });
    section.tables.push(TextTable {
        title: "Judges on trials as recorded".into(),
        header: [
            "judge",
            "model",
            "success rate",
            "+-",
            "trials",
            "without a usable answer",
            "consensus",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: judges.collect(),
    });
    let mut rows = Vec::new();
    for (index, a) in names.iter().enumerate() {
        for b in names.iter().skip(index + 1) {
            let both = trials
                .iter()
                .filter_map(|trial| Some((rated(trial, a)?, rated(trial, b)?)));
            let (first, second): (Vec<bool>, Vec<bool>) = both.unzip();
            let kappa = cohen_kappa(&first, &second).ok();
            rows.push(vec![
                (*a).to_owned(),
                (*b).to_owned(),
                kappa.map_or_else(|| "-".into(), |kappa| format!("{kappa:.3}")),
                first.len().to_string(),
                mark(is_chosen(a) && is_chosen(b)),
            ]);
            let name = format!("kappa_{}_{}", slug(a), slug(b));
            match kappa {
                Some(kappa) => {
                    let about =
                        format!("Cohen's kappa of {a} and {b} over all trials scored by both");
                    section.metric(
                        &name,
                        Metric::plain(kappa, first.len(), Better::Higher, &about),
                    );
                }
                None => section.absent(
                    &name,
                    "one label for all trials: agreement is by chance alone",
                ),
            }
        }
    }
    if !rows.is_empty() {
        section.tables.push(TextTable {
            title: "Agreement of judges on all trials".into(),
            header: ["judge", "and", "Cohen's kappa", "trials", "consensus"]
                .map(str::to_owned)
                .to_vec(),
            rows,
        });
    }
}
