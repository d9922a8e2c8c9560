//! Figures of the trials: means over tasks of means over trials.

use std::collections::BTreeMap;

use wm_metrics::findings::{Better, Metric, Section};
use wm_metrics::statistics::{bootstrap_clustered_mean, standard_error_of_share, wilson};

use super::consensus::ConsensusPair;
use crate::{
    Settings,
    figures::{FEWEST, draws, mean_over_units},
    policy::{Condition, ImaginedTrial, Rubric},
};

/// A rating of trials.
pub(super) struct Score<'a> {
    /// Name of the figure.
    pub name: String,
    /// Title of a column.
    pub title: String,
    pub about: String,
    /// Whether it is a success rate.
    pub is_rate: bool,
    /// The rating of one trial, if it has one.
    pub of: Box<Of<'a>>,
}

type Of<'a> = dyn Fn(&ImaginedTrial) -> Option<f64> + 'a;

/// All ratings.
pub(super) fn scores<'a>(
    settings: &'a Settings,
    pair: Option<&'a ConsensusPair>,
) -> Vec<Score<'a>> {
    let mut scores = vec![
        Score {
            name: "probe_probability".into(),
            title: "probe, mean".into(),
            about: "probability of success by the success probe on imagined latents".into(),
            is_rate: false,
            of: Box::new(|trial| trial.probe.map(f64::from)),
        },
        Score {
            name: "probe_success".into(),
            title: "probe".into(),
            about: "share of trials that the success probe gives more than one half".into(),
            is_rate: true,
            of: Box::new(|trial| trial.probe.map(|p| f64::from(p > 0.5))),
        },
    ];
    for judge in &settings.policy.inputs.judges {
        scores.push(Score {
            name: format!("success_by_{}", slug(&judge.name)),
            title: judge.name.clone(),
            about: format!(
                "share of trials that {} ({}) calls a success",
                judge.name, judge.model
            ),
            is_rate: true,
            of: Box::new(|trial| trial.success_by(&judge.name).map(f64::from)),
        });
    }
    if let Some(ConsensusPair { judges, .. }) = pair {
        let [first, second] = judges;
        scores.push(Score {
            name: "consensus_success".into(),
            title: "consensus".into(),
            about: format!("share of trials that {first} and {second} both call a success"),
            is_rate: true,
            of: Box::new(move |trial| {
                Some(f64::from(
                    trial.success_by(first)? && trial.success_by(second)?,
                ))
            }),
        });
        scores.push(Score {
            name: "mean_rater_success".into(),
            title: "mean of raters".into(),
            about: format!("mean of the success rates by {first} and {second}"),
            is_rate: false,
            of: Box::new(move |trial| {
                let both = [trial.success_by(first)?, trial.success_by(second)?];
                Some(both.into_iter().map(f64::from).sum::<f64>() / 2.0)
            }),
        });
    }
    if let Some(first) = settings.policy.inputs.judges.first() {
        type Part = fn(&Rubric) -> u8;
        let rubric: [(&str, &str, Part); 3] = [
            ("interaction_quality", "plausibility of contact", |r| {
                r.interaction_quality
            }),
            ("perspectivity", "spatial consistency", |r| r.perspectivity),
            (
                "instruction_following",
                "completion of the instruction",
                |r| r.instruction_following,
            ),
        ];
        scores.extend(rubric.map(|(name, about, of)| Score {
            name: name.into(),
            title: name.replace('_', " "),
            about: format!("{about}, 1 to 5 by {}", first.name),
            is_rate: false,
            of: Box::new(move |trial| {
                let rubric = trial.verdicts.as_ref()?.rubric.as_ref()?;
                Some(f64::from(of(rubric)))
            }),
        }));
    }
    scores
}

/// A name in lower-case letters, digits and underscores.
pub(super) fn slug(name: &str) -> String {
    let plain = name.chars().map(|c| {
        if c.is_ascii_alphanumeric() {
            c.to_ascii_lowercase()
        } else {
            '_'
        }
    });
    plain.collect()
}

/// Adds the figures of every condition, the losses out of distribution, and the accuracy on recorded actions.
pub(super) fn add(
    section: &mut Section,
    trials: &[&ImaginedTrial],
    scores: &[Score<'_>],
    settings: &Settings,
) {
    let changes = Condition::CHANGED.map(|own| (own.prefix(), own.words(), vec![own]));
    let has = |condition: &Condition| trials.iter().any(|trial| trial.condition == *condition);
    // The paper's table 12 pools both.
    let pooled = Condition::CHANGED.iter().all(has).then(|| {
        let words = "other instruction or first frame";
        ("ood_", words, Condition::CHANGED.to_vec())
    });
    let changes: Vec<_> = changes.into_iter().chain(pooled).collect();
    for score in scores {
        let recorded = by_task(trials, &[Condition::Recorded], score);
        if let Some(metric) = metric(&recorded, score, settings, "") {
            section.metric(&score.name, metric);
        }
        for (prefix, words, conditions) in &changes {
            let changed = by_task(trials, conditions, score);
            let how = format!(", {words}");
            let Some(metric) = metric(&changed, score, settings, &how) else {
                continue;
            };
            let name = format!("{prefix}{}", score.name);
            section.metric(&name, metric);
            let drops: Vec<(String, f64)> = changed
                .iter()
                .filter_map(|(task, changed)| {
                    let recorded = recorded.get(task)?;
                    Some(((*task).to_owned(), mean(recorded) - mean(changed)))
                })
                .collect();
            let about = format!(
                "{}: on the same tasks as recorded, minus that on these trials ({words})",
                score.about
            );
            let drop = mean_over_units(&drops, settings, Better::Lower, &about);
            if let Some(drop) = drop {
                section.metric(&format!("{name}_drop"), drop);
            }
        }
    }
    add_of_recordings(section, trials, settings);
}

fn metric(
    tasks: &BTreeMap<&str, Vec<f64>>,
    score: &Score<'_>,
    settings: &Settings,
    how: &str,
) -> Option<Metric> {
    let values: Vec<&Vec<f64>> = tasks.values().collect();
    let estimate = bootstrap_clustered_mean(&values, &draws(settings)).ok()?;
    let n = values.iter().map(|values| values.len()).sum();
    let mut about = format!("{}{how}; mean over {} tasks", score.about, tasks.len());
    if score.is_rate {
        // Each is 0 or 1.
        let successes = values.iter().flat_map(|v| v.iter()).sum::<f64>() as usize;
        let error = standard_error_of_share(successes, n).ok()?;
        about += &format!(
            " (+- {error:.3} by sqrt(p (1 - p) / n), the paper's, as if trials were independent)"
        );
    }
    let mut interval = estimate.interval;
    if score.is_rate && interval.low == interval.high {
        // With no or only successes, the bootstrap interval has zero width.
        let successes = if estimate.value > 0.5 { tasks.len() } else { 0 };
        interval = wilson(successes, tasks.len()).ok()?;
        about += "; Wilson's interval over tasks";
    }
    let samples = tasks.iter();
    let samples = samples.map(|(task, values)| ((*task).to_owned(), mean(values)));
    Some(Metric {
        interval: (tasks.len() >= FEWEST).then_some(interval),
        samples: samples.collect(),
        ..Metric::plain(estimate.value, n, Better::Higher, &about)
    })
}

fn by_task<'t>(
    trials: &[&'t ImaginedTrial],
    conditions: &[Condition],
    score: &Score<'_>,
) -> BTreeMap<&'t str, Vec<f64>> {
    let mut tasks: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let chosen = trials
        .iter()
        .filter(|trial| conditions.contains(&trial.condition));
    for trial in chosen {
        if let Some(value) = (score.of)(trial) {
            tasks.entry(&trial.task).or_default().push(value);
        }
    }
    tasks
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// For the recorded policy: the probe on imagined latents against the probe on the frames, and against the outcome.
fn add_of_recordings(section: &mut Section, trials: &[&ImaginedTrial], settings: &Settings) {
    type Told = fn(&ImaginedTrial) -> Option<f64>;
    let figures: [(&str, &str, Told); 4] = [
        (
            "recorded_success",
            "success rate of the recordings, as recorded",
            |trial| trial.outcome.map(f64::from),
        ),
        (
            "recorded_probe_on_frames",
            "probability of success by the success probe on the latents of the recorded frames, to the trial's last step or the \
             episode's end",
            |trial| trial.probe_on_frames.map(f64::from),
        ),
        (
            "recorded_agreement_with_frames",
            "share of trials with the same probe verdict on imagined latents and on recorded frames",
            |trial| {
                let (imagined, real) = (trial.probe?, trial.probe_on_frames?);
                Some(f64::from((imagined > 0.5) == (real > 0.5)))
            },
        ),
        (
            "recorded_agreement_with_outcome",
            "share of trials in which the probe verdict on imagined latents equals the recorded success",
            |trial| Some(f64::from((trial.probe? > 0.5) == trial.outcome?)),
        ),
    ];
    for (name, about, of) in figures {
        let score = Score {
            name: name.into(),
            title: String::new(),
            about: about.into(),
            is_rate: false,
            of: Box::new(of),
        };
        let tasks = by_task(trials, &[Condition::Recorded], &score);
        if let Some(metric) = metric(&tasks, &score, settings, "") {
            section.metric(name, metric);
        }
    }
}
