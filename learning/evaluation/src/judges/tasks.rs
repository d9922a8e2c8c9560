//! Tasks of rollouts.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde::Deserialize;

use crate::judges::{Error, Result, text_file};

/// Embedded tasks: the paper's 20 of Bridge V2, ten of them with an out-of-distribution instruction.
pub const BRIDGE_V2_YAML: &str = include_str!("../../tasks/bridge_v2.yaml");

/// The tasks of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tasks {
    levels: BTreeMap<u8, String>,
    tasks: Vec<Task>,
}

/// A task of the robot.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Task {
    /// Instruction of the robot.
    pub instruction: String,
    /// Level of difficulty; see [`Tasks::level_name`].
    pub level: u8,
    /// Replacement of the instruction in the out-of-distribution test.
    pub ood: Option<OodInstruction>,
    /// Criteria of half a success.
    pub partial_criteria: Option<String>,
}

/// An instruction that does not match the scene.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct OodInstruction {
    /// The other instruction.
    pub instruction: String,
    /// Kind of difference, such as `Action reversal`.
    pub variation: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    levels: BTreeMap<u8, String>,
    tasks: Vec<TaskDocument>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskDocument {
    instruction: String,
    level: u8,
    ood_instruction: Option<String>,
    variation: Option<String>,
    partial_criteria: Option<String>,
}

impl Tasks {
    /// The embedded tasks.
    ///
    /// # Errors
    /// None, as tested.
    pub fn bridge_v2() -> Result<Self> {
        Self::parse(BRIDGE_V2_YAML)
    }

    /// Reads a file like [`BRIDGE_V2_YAML`].
    ///
    /// # Errors
    /// If it cannot be read, and those of [`Self::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&text_file::read(path)?)
    }

    /// Parses a text like [`BRIDGE_V2_YAML`].
    ///
    /// # Errors
    /// For a missing or unknown key, or a task that is repeated, is empty, has a level without a name, or only one of
    /// `ood_instruction` and `variation`.
    pub fn parse(yaml: &str) -> Result<Self> {
        let Document { levels, tasks } = text_file::parse("a file of tasks", yaml)?;
        let tasks = tasks.into_iter().map(TaskDocument::check);
        let tasks: Vec<Task> = tasks.collect::<Result<_>>()?;
        let mut seen = BTreeSet::new();
        for task in &tasks {
            if !levels.contains_key(&task.level) {
                let known: Vec<&u8> = levels.keys().collect();
                return Err(problem(
                    &task.instruction,
                    format!("its level is {}, expected one of {known:?}", task.level),
                ));
            }
            if !seen.insert(&task.instruction) {
                return Err(problem(
                    &task.instruction,
                    "there twice, expected once".to_owned(),
                ));
            }
        }
        Ok(Self { levels, tasks })
    }

    /// Tasks in the order of the file.
    #[must_use]
    pub fn tasks(&self) -> &[Task] {
        &self.tasks
    }

    /// Tasks with an out-of-distribution instruction.
    pub fn out_of_distribution(&self) -> impl Iterator<Item = (&Task, &OodInstruction)> {
        let pairs = self.tasks.iter();
        pairs.filter_map(|task| Some((task, task.ood.as_ref()?)))
    }

    /// Names of the levels.
    #[must_use]
    pub fn levels(&self) -> &BTreeMap<u8, String> {
        &self.levels
    }

    /// Name of a level; every task's level has one.
    #[must_use]
    pub fn level_name(&self, level: u8) -> Option<&str> {
        self.levels.get(&level).map(String::as_str)
    }
}

impl TaskDocument {
    fn check(self) -> Result<Task> {
        let Self {
            instruction,
            level,
            ood_instruction,
            variation,
            partial_criteria,
        } = self;
        let texts = [
            Some(&instruction),
            ood_instruction.as_ref(),
            variation.as_ref(),
            partial_criteria.as_ref(),
        ];
        if texts
            .into_iter()
            .flatten()
            .any(|text| text.trim().is_empty())
        {
            return Err(problem(
                &instruction,
                "an empty text, expected words".to_owned(),
            ));
        }
        let ood = match (ood_instruction, variation) {
            (None, None) => None,
            (Some(instruction), Some(variation)) => Some(OodInstruction {
                instruction,
                variation,
            }),
            _ => {
                return Err(problem(
                    &instruction,
                    "one of ood_instruction and variation, expected both or none".to_owned(),
                ));
            }
        };
        Ok(Task {
            instruction,
            level,
            ood,
            partial_criteria,
        })
    }
}

fn problem(instruction: &str, problem: String) -> Error {
    Error::Task {
        instruction: instruction.to_owned(),
        problem,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_match_the_paper() {
        let tasks = Tasks::bridge_v2().unwrap();
        let of_level = |level| {
            tasks
                .tasks()
                .iter()
                .filter(|task| task.level == level)
                .count()
        };
        assert_eq!([1, 2, 3, 4].map(of_level), [4, 7, 5, 4]);
        assert_eq!(tasks.levels().len(), 4);
        assert!(
            tasks
                .level_name(3)
                .unwrap()
                .starts_with("Precise placement")
        );
        let pairs: Vec<_> = tasks.out_of_distribution().collect();
        assert_eq!(pairs.len(), 10);
        let reversed = pairs
            .iter()
            .filter(|(_, ood)| ood.variation == "Action reversal");
        assert_eq!(reversed.count(), 4);
        assert!(
            tasks
                .tasks()
                .iter()
                .any(|task| task.instruction == "close brown1fbox flap")
        );
    }

    #[test]
    fn tasks_of_the_tabletop_have_levels_and_pairs() {
        let tasks = Tasks::parse(include_str!("../../tasks/tabletop.yaml")).unwrap();
        for level in 1..=4 {
            let of_level = tasks.tasks().iter().filter(|task| task.level == level);
            assert_eq!(of_level.count(), 5, "level {level}");
        }
        assert_eq!(tasks.out_of_distribution().count(), 10);
    }

    #[test]
    fn faulty_files_are_rejected_by_name() {
        let cases = [
            (
                "levels: {1: a}\ntasks: [{instruction: b, level: 2}]",
                "expected one of [1]",
            ),
            (
                "levels: {1: a}\ntasks: [{instruction: b, level: 1}, {instruction: b, level: 1}]",
                "twice",
            ),
            (
                "levels: {1: a}\ntasks: [{instruction: b, level: 1, variation: c}]",
                "both or none",
            ),
            (
                "levels: {1: a}\ntasks: [{instruction: ' ', level: 1}]",
                "expected words",
            ),
            (
                "levels: {1: a}\ntasks: [{instruction: b, level: 1, speed: 3}]",
                "speed",
            ),
        ];
        for (yaml, named) in cases {
            let error = Tasks::parse(yaml).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
