//! Agreement of judges.

use wm_metrics::classification::cohen_kappa;
use wm_metrics::findings::{Better, Metric, Section, TextTable};

use super::{
    consensus::{ConsensusPair, names},
    mean,
    rates::{Score, slug},
};
use crate::{
    Settings,
    policy::{Condition, ImaginedTrial},
};

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
            of: Box::new(|trial| trial.success_by(&judge.name).map(f64::from)),
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
                .filter_map(|trial| Some((trial.success_by(a)?, trial.success_by(b)?)));
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
