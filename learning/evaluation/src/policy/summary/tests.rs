#![allow(clippy::unwrap_used)]

use super::*;
use crate::{
    Protocol,
    policy::{JudgeInputs, Rubric, Verdicts},
};

fn judged(judges: &[&str]) -> Settings {
    let mut settings = Settings::of(Protocol::Quick, 0);
    settings.resamples = 200;
    settings.policy.inputs.judges = judges
        .iter()
        .map(|name| JudgeInputs {
            name: (*name).into(),
            model: format!("{name}-7B"),
            temperature: None,
            seed: None,
        })
        .collect();
    settings
}

fn trial(task: usize, trial: usize, scores: &[(&str, Option<f64>)]) -> (String, ImaginedTrial) {
    let scores = scores
        .iter()
        .map(|(judge, score)| ((*judge).to_owned(), *score));
    let imagined = ImaginedTrial {
        task: format!("task {task}"),
        trial,
        condition: Condition::Recorded,
        instruction: format!("do {task}"),
        level: Some((1 + task as u8 % 2, "a level".into())),
        probe: Some(0.25 * task as f32),
        probe_on_frames: None,
        outcome: None,
        verdicts: Some(Verdicts {
            scores: scores.collect(),
            rubric: Some(Rubric {
                interaction_quality: 3,
                perspectivity: 4,
                instruction_following: 1 + trial as u8,
            }),
        }),
        clipped: 1,
        values: 10,
        strip: None,
    };
    (format!("task {task} trial {trial}"), imagined)
}

/// Four tasks with two trials.
fn trials(
    scores: impl Fn(usize, usize) -> Vec<(&'static str, Option<f64>)>,
) -> Vec<(String, ImaginedTrial)> {
    let all = (0..4).flat_map(|task| (0..2).map(move |trial| (task, trial)));
    all.map(|(task, number)| trial(task, number, &scores(task, number)))
        .collect()
}

#[test]
fn consensus_needs_both_judges() {
    let both = |task: usize, trial: usize| {
        vec![
            ("a", Some(if task == 0 { 0.5 } else { 0.0 })),
            ("b", Some(f64::from(u8::from(trial == 0)))),
        ]
    };
    let section = summarise(&trials(both), &judged(&["a", "b"]));
    let metric = |name: &str| &section.metrics[&format!("policy.{name}")];
    assert_eq!(metric("success_by_a").value, 0.25);
    assert_eq!(metric("success_by_b").value, 0.5);
    let consensus = metric("consensus_success");
    assert_eq!((consensus.value, consensus.n), (0.125, 8));
    let interval = consensus.interval.unwrap();
    assert!(interval.low == 0.0 && interval.high > 0.2, "{interval:?}");
    // sqrt(1/8 7/8 / 8)
    assert!(consensus.about.contains("+- 0.117"), "{}", consensus.about);
    assert_eq!(metric("mean_rater_success").value, 0.375);
    assert_eq!(metric("kappa_a_b").value, 0.0);
    assert_eq!(metric("instruction_following").value, 1.5);
    assert_eq!(metric("probe_success").value, 0.25);
    assert_eq!(
        section.tables[0].rows[0][2..6],
        ["0.250", "0.153", "8", "0"]
    );
    assert!(
        section
            .notes
            .iter()
            .any(|note| note.contains("8 of 80 values"))
    );
}

#[test]
fn unusable_answers_are_counted_without_effect_on_rates() {
    let some = |task: usize, _| vec![("a", (task > 0).then_some(1.0)), ("b", Some(1.0))];
    let section = summarise(&trials(some), &judged(&["a", "b"]));
    let consensus = &section.metrics["policy.consensus_success"];
    assert_eq!(
        (consensus.value, consensus.n, consensus.samples.len()),
        (1.0, 6, 3)
    );
    // A bootstrap of ones has no width.
    let interval = consensus.interval.unwrap();
    assert!(interval.low < 0.5 && interval.high == 1.0, "{interval:?}");
    assert_eq!(section.tables[0].rows[0][5], "2");
    // Both always answer yes.
    assert!(
        section
            .absent
            .iter()
            .any(|absent| absent.metric == "policy.kappa_a_b")
    );
}

#[test]
fn closest_two_of_three_judges_decide() {
    let three = |task: usize, trial: usize| {
        let score = |is: bool| Some(f64::from(u8::from(is)));
        vec![
            ("a", score(task == 0)),
            ("b", score(trial == 0)),
            ("c", score(task == 0 || (task == 1 && trial == 0))),
        ]
    };
    let settings = judged(&["a", "b", "c"]);
    let section = summarise(&trials(three), &settings);
    let chosen: Vec<&str> = section.tables[0].rows.iter().map(|row| &*row[6]).collect();
    assert_eq!(chosen, ["yes", "", "yes"]);
    assert!(
        section.metrics["policy.consensus_success"]
            .about
            .contains("a and c")
    );

    let alike = |_, _| vec![("a", Some(1.0)), ("b", Some(1.0)), ("c", Some(1.0))];
    let section = summarise(&trials(alike), &settings);
    assert!(
        section
            .notes
            .iter()
            .any(|note| note.contains("the first two of 3 judges"))
    );
}

#[test]
fn drops_compare_the_same_tasks() {
    let mut all = trials(|task, _| vec![("a", Some(f64::from(u8::from(task < 2))))]);
    for task in [0, 2] {
        let (name, imagined) = trial(task, 0, &[("a", Some(0.0))]);
        let changed = ImaginedTrial {
            condition: Condition::OtherInstruction,
            ..imagined
        };
        all.push((name, changed));
    }
    let section = summarise(&all, &judged(&["a"]));
    let drop = &section.metrics["policy.ood_instruction_success_by_a_drop"];
    assert_eq!((drop.value, drop.n), (0.5, 2));
    assert!(
        !section
            .metrics
            .contains_key("policy.ood_distractor_success_by_a")
    );
    let absent: Vec<&str> = section
        .absent
        .iter()
        .map(|absent| &*absent.metric)
        .collect();
    assert_eq!(
        absent,
        ["policy.consensus_success", "policy.ood_distractor_success"]
    );
    // By instruction: four as recorded, and two changed.
    assert_eq!(section.tables.last().unwrap().rows.len(), 6);
}

#[test]
fn changed_conditions_are_pooled_by_task() {
    let mut all = trials(|_, _| vec![("a", Some(1.0))]);
    for (task, condition, score) in [
        (0, Condition::OtherInstruction, 0.0),
        (0, Condition::OtherFrame, 1.0),
        (1, Condition::OtherInstruction, 0.0),
    ] {
        let (name, imagined) = trial(task, 0, &[("a", Some(score))]);
        all.push((
            name,
            ImaginedTrial {
                condition,
                ..imagined
            },
        ));
    }
    let section = summarise(&all, &judged(&["a"]));
    let value = |name: &str| {
        let metric = &section.metrics[&format!("policy.ood_{name}")];
        (metric.value, metric.n)
    };
    // The mean over tasks of means over trials.
    assert_eq!(value("success_by_a"), (0.25, 3));
    assert_eq!(value("success_by_a_drop"), (0.75, 2));
    assert_eq!(value("instruction_success_by_a"), (0.0, 2));
    assert_eq!(value("distractor_success_by_a"), (1.0, 1));
}

#[test]
fn missing_trials_have_a_reason() {
    let section = summarise(&[], &judged(&[]));
    assert!(section.metrics.is_empty());
    assert!(section.absent[0].why.contains("/task/instruction"));
}
