//! Rates by level and by instruction.

use std::collections::BTreeSet;

use wm_metrics::findings::{Section, TextTable};

use super::{mean, rates::Score};
use crate::policy::{Condition, ImaginedTrial};

/// Adds both tables.
pub(super) fn add(section: &mut Section, trials: &[&ImaginedTrial], scores: &[Score<'_>]) {
    let has = |score: &&Score<'_>| trials.iter().any(|trial| (score.of)(trial).is_some());
    let scores: Vec<&Score<'_>> = scores.iter().filter(has).collect();
    if trials.is_empty() {
        return;
    }
    let titles = |first: &[&str]| -> Vec<String> {
        let titles = scores.iter().map(|score| score.title.clone());
        first
            .iter()
            .map(|title| (*title).to_owned())
            .chain(titles)
            .collect()
    };
    let levels: BTreeSet<&(u8, String)> = trials.iter().filter_map(|t| t.level.as_ref()).collect();
    if !levels.is_empty() {
        let rows = levels.into_iter().map(|level| {
            let own: Vec<&ImaginedTrial> = trials
                .iter()
                .copied()
                .filter(|t| t.condition == Condition::Recorded && t.level.as_ref() == Some(level))
                .collect();
            let tasks: BTreeSet<&str> = own.iter().map(|trial| &*trial.task).collect();
            let (number, name) = level;
            let first = vec![format!("{number}: {name}"), tasks.len().to_string()];
            row(first, &own, &scores)
        });
        section.tables.push(TextTable {
            title: "By level of difficulty".into(),
            header: titles(&["level", "tasks", "trials"]),
            rows: rows.collect(),
        });
    }
    // In the order of the tasks.
    let mut groups: Vec<(&str, Condition)> = Vec::new();
    for trial in trials {
        let group = (&*trial.instruction, trial.condition);
        if !groups.contains(&group) {
            groups.push(group);
        }
    }
    let rows = groups.into_iter().map(|(instruction, condition)| {
        let own = |trial: &&ImaginedTrial| {
            (&*trial.instruction, trial.condition) == (instruction, condition)
        };
        let own: Vec<&ImaginedTrial> = trials.iter().copied().filter(own).collect();
        let level = own.first().and_then(|trial| trial.level.as_ref());
        let level = level.map_or("-".into(), |(number, _)| number.to_string());
        let first = vec![instruction.to_owned(), condition.words().to_owned(), level];
        row(first, &own, &scores)
    });
    section.tables.push(TextTable {
        title: "By instruction".into(),
        header: titles(&["instruction", "tried", "level", "trials"]),
        rows: rows.collect(),
    });
}

fn row(mut row: Vec<String>, own: &[&ImaginedTrial], scores: &[&Score<'_>]) -> Vec<String> {
    row.push(own.len().to_string());
    let means = scores.iter().map(|score| {
        let mean = mean(own.iter().copied(), score);
        mean.map_or_else(|| "-".into(), |(mean, _)| format!("{mean:.3}"))
    });
    row.extend(means);
    row
}
