//! The tasks among the episodes.

use std::collections::BTreeMap;

use crate::judges::Tasks;
use anyhow::{Result, ensure};
use wm_dataset::Episode;

use super::{Condition, Setup};
use crate::{Subject, spread};

/// An episode as a task.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Task {
    /// Index of the episode.
    pub episode: usize,
    /// Name of the episode, with a number if several share it.
    pub name: String,
    pub instruction: String,
    /// Level of difficulty, with its name.
    pub level: Option<(u8, String)>,
    /// The other instruction.
    pub other_instruction: Option<String>,
    pub partial_criteria: Option<String>,
    /// Whether another first frame exists.
    pub has_other_frame: bool,
}

impl Task {
    /// Conditions of its trials.
    pub fn conditions(&self, setup: &Setup) -> impl Iterator<Item = Condition> {
        let is_told_another = setup.other_instructions && self.other_instruction.is_some();
        let conditions = [
            (Condition::Recorded, true),
            (Condition::OtherInstruction, is_told_another),
            (Condition::OtherFrame, self.has_other_frame),
        ];
        let conditions = conditions.into_iter().filter(|(_, is_tried)| *is_tried);
        conditions.map(|(condition, _)| condition)
    }

    /// The instruction for policy and judges.
    pub fn instruction_under(&self, condition: Condition) -> &str {
        match (condition, &self.other_instruction) {
            (Condition::OtherInstruction, Some(other)) => other,
            _ => &self.instruction,
        }
    }
}

/// Chooses at most `most` tasks: those of a file, each instruction once before any repeats; else spread over all.
///
/// # Errors
/// If no episode is one of the requested tasks.
pub(super) fn choose(subject: &Subject, setup: &Setup, most: usize) -> Result<Vec<Task>> {
    let names = unique_names(subject.dataset.episodes());
    let episodes = subject.dataset.episodes().iter().zip(names).enumerate();
    let all: Vec<Task> = episodes
        .filter(|(index, _)| !subject.frames_of(*index, 1).is_empty())
        .filter_map(|(index, (episode, name))| task(index, episode, name, setup))
        .collect();
    let chosen = match &setup.tasks {
        None => spread(all, most),
        Some(tasks) => {
            ensure!(
                !all.is_empty(),
                "no episode has an instruction of the tasks file, such as {:?}; the data has {}",
                tasks.tasks().first().map_or("", |task| &*task.instruction),
                some_instructions(subject.dataset.episodes())
            );
            each_once_first(all, most)
        }
    };
    if let Some(images) = &setup.start_images {
        ensure!(
            chosen.iter().any(|task| task.has_other_frame),
            "none of the first frames ({}, ...) is named as one of the tasks ({}, ...)",
            images.episodes().take(3).collect::<Vec<_>>().join(", "),
            chosen
                .iter()
                .take(3)
                .map(|task| &*task.name)
                .collect::<Vec<_>>()
                .join(", ")
        );
    }
    Ok(chosen)
}

fn task(index: usize, episode: &Episode, name: String, setup: &Setup) -> Option<Task> {
    let instruction = episode.instruction.as_deref()?.trim();
    if instruction.is_empty() {
        return None;
    }
    let plain = Task {
        episode: index,
        has_other_frame: setup
            .start_images
            .as_ref()
            .is_some_and(|images| images.has(&name)),
        name,
        instruction: instruction.to_owned(),
        level: None,
        other_instruction: None,
        partial_criteria: None,
    };
    let Some(tasks) = &setup.tasks else {
        return Some(plain);
    };
    let listed = known(tasks, instruction)?;
    let level_name = tasks.level_name(listed.level).unwrap_or_default();
    Some(Task {
        level: Some((listed.level, level_name.to_owned())),
        other_instruction: listed.ood.as_ref().map(|ood| ood.instruction.clone()),
        partial_criteria: listed.partial_criteria.clone(),
        ..plain
    })
}

/// Ignores case, which varies between recordings.
fn known<'a>(tasks: &'a Tasks, instruction: &str) -> Option<&'a crate::judges::tasks::Task> {
    let lower = instruction.to_lowercase();
    let mut tasks = tasks.tasks().iter();
    tasks.find(|task| task.instruction.trim().to_lowercase() == lower)
}

/// In the order of the episodes.
fn each_once_first(all: Vec<Task>, most: usize) -> Vec<Task> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut ranked: Vec<(usize, Task)> = all
        .into_iter()
        .map(|task| {
            let count = seen.entry(task.instruction.to_lowercase()).or_default();
            *count += 1;
            (*count, task)
        })
        .collect();
    ranked.sort_by_key(|(count, task)| (*count, task.episode));
    ranked.truncate(most.max(1));
    ranked.sort_by_key(|(_, task)| task.episode);
    ranked.into_iter().map(|(_, task)| task).collect()
}

/// Bags of different folders may share a name.
fn unique_names(episodes: &[Episode]) -> Vec<String> {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let names = episodes.iter().map(|episode| {
        let count = seen.entry(&episode.name).or_default();
        *count += 1;
        match *count {
            1 => episode.name.clone(),
            again => format!("{} ({again})", episode.name),
        }
    });
    names.collect()
}

fn some_instructions(episodes: &[Episode]) -> String {
    let instructions = episodes
        .iter()
        .filter_map(|episode| episode.instruction.as_deref());
    let instructions: Vec<String> = instructions
        .take(3)
        .map(|text| format!("{text:?}"))
        .collect();
    if instructions.is_empty() {
        return "no instruction (/task/instruction)".into();
    }
    format!("{}, ...", instructions.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(episode: usize, instruction: &str) -> Task {
        Task {
            episode,
            name: format!("bag_{episode}"),
            instruction: instruction.into(),
            level: None,
            other_instruction: None,
            partial_criteria: None,
            has_other_frame: false,
        }
    }

    #[test]
    fn instructions_come_once_before_any_repeats() {
        let all = || vec![named(0, "a"), named(1, "A"), named(2, "b"), named(3, "a")];
        let chosen = |most| -> Vec<usize> {
            let chosen = each_once_first(all(), most);
            chosen.iter().map(|task| task.episode).collect()
        };
        assert_eq!(chosen(2), [0, 2]);
        assert_eq!(chosen(3), [0, 1, 2]);
        assert_eq!(chosen(9), [0, 1, 2, 3]);
    }

    #[test]
    fn episodes_of_one_name_get_numbers() {
        let of = |name: &str| Episode {
            name: name.into(),
            ..Episode::default()
        };
        let names = unique_names(&[of("a"), of("b"), of("a")]);
        assert_eq!(names, ["a", "b", "a (2)"]);
    }
}
