//! Findings of the success probes.

use wm_metrics::classification::{Confusion, roc_auc};
use wm_metrics::findings::{Better, Metric, Section, TextTable};

use super::super::{Answers, EpisodeVerdicts};
use crate::{Settings, figures::figure_of_units};

type Of = fn(&Answers) -> f32;

/// Adds the figures of one probe.
pub(super) fn of_probe(
    section: &mut Section,
    judged: &[&EpisodeVerdicts],
    settings: &Settings,
    probe: usize,
) {
    let episodes = judged
        .iter()
        .filter_map(|judged| Some((judged.success, judged.probes.get(probe)?)));
    let episodes: Vec<(bool, &Answers)> = episodes.collect();
    let Some((_, Answers { name, about, .. })) = episodes.first() else {
        return;
    };
    let sources: [(&str, &str, Of); 2] = [
        ("real", "the latents of the frames", |answers| answers.real),
        (
            "predicted",
            "a rollout of the whole episode from two frames under its actions",
            |answers| answers.predicted,
        ),
    ];
    let pick = |chosen: &[usize], of: Of| -> (Vec<f64>, Vec<bool>) {
        let chosen = chosen.iter().filter_map(|index| episodes.get(*index));
        chosen
            .map(|(success, answers)| (f64::from(of(answers)), *success))
            .unzip()
    };
    let balanced = |chosen: &[usize], of: Of| {
        let (scores, truth) = pick(chosen, of);
        let verdicts: Vec<bool> = scores.iter().map(|p| *p > 0.5).collect();
        let confusion = Confusion::of(&verdicts, &truth).ok();
        confusion
            .and_then(|c| c.balanced_accuracy())
            .unwrap_or(f64::NAN)
    };
    let auc = |chosen: &[usize], of: Of| {
        let (scores, truth) = pick(chosen, of);
        roc_auc(&scores, &truth).unwrap_or(f64::NAN)
    };
    let n = episodes.len();
    for (source, on, of) in sources {
        let mut add = |figure: &str, about: String, metric: Option<Metric>| {
            let name = format!("{name}_{figure}_{source}");
            match metric {
                Some(metric) => section.metric(&name, Metric { about, ..metric }),
                None => section.absent(
                    &name,
                    format!("the {n} episodes with an outcome are all successes, or all failures"),
                ),
            }
        };
        let figure = |figure: &(dyn Fn(&[usize]) -> f64 + Sync)| {
            figure_of_units(n, settings, Better::Higher, "", figure)
        };
        add(
            "balanced_accuracy",
            format!("balanced accuracy of the {about} at one half, on {on}"),
            figure(&|chosen| balanced(chosen, of)),
        );
        add(
            "auc",
            format!("area under the ROC curve of the {about}, on {on}"),
            figure(&|chosen| auc(chosen, of)),
        );
        let all: Vec<usize> = (0..n).collect();
        let (scores, truth) = pick(&all, of);
        section
            .tables
            .push(confusion_table((about, source), &scores, &truth));
    }
    let says = format!("balanced accuracy of the {about}, real minus predicted: semantic drift");
    let drop = figure_of_units(n, settings, Better::Lower, &says, |chosen| {
        balanced(chosen, |answers| answers.real) - balanced(chosen, |answers| answers.predicted)
    });
    if let Some(metric) = drop {
        section.metric(&format!("{name}_drop"), metric);
    }
    let mismatched = episodes
        .iter()
        .filter_map(|(_, answers)| answers.mismatched);
    let mismatched: Vec<f32> = mismatched.collect();
    if !mismatched.is_empty() {
        let about = "share of the successes rejected under another episode's instruction";
        let metric = figure_of_units(
            mismatched.len(),
            settings,
            Better::Higher,
            about,
            |chosen| {
                let chosen = chosen.iter().filter_map(|index| mismatched.get(*index));
                let refused = chosen.clone().filter(|p| **p <= 0.5).count();
                refused as f64 / chosen.count() as f64
            },
        );
        if let Some(metric) = metric {
            section.metric(&format!("{name}_mismatches_refused"), metric);
        }
    }
}

fn confusion_table((about, source): (&str, &str), scores: &[f64], truth: &[bool]) -> TextTable {
    let count = |verdicts: bool, is: bool| {
        let pairs = scores.iter().zip(truth);
        let like = pairs.filter(|(score, truth)| (**score > 0.5) == verdicts && **truth == is);
        like.count().to_string()
    };
    TextTable {
        title: format!("Verdicts of the {about}, {source} latents"),
        header: ["", "verdict: success", "verdict: failure"]
            .map(String::from)
            .into(),
        rows: vec![
            vec!["success".into(), count(true, true), count(false, true)],
            vec!["failure".into(), count(true, false), count(false, false)],
        ],
    }
}
