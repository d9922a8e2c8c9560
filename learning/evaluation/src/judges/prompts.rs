//! The prompts of judges.

mod template;

use std::path::Path;

use serde::Deserialize;

use crate::judges::{Result, text_file};
use template::{Placeholder, Template};

/// Embedded prompts, with notes on which parts are the paper's.
pub const PAPER_YAML: &str = include_str!("../../prompts/paper.yaml");

/// The prompts of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prompts {
    binary: Template,
    partial: Template,
    rubric: Template,
    distractor: Template,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    success: SuccessDocument,
    rubric: String,
    distractor: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SuccessDocument {
    binary: String,
    partial: String,
}

impl Prompts {
    /// The embedded prompts.
    ///
    /// # Errors
    /// None, as tested.
    pub fn paper() -> Result<Self> {
        Self::parse(PAPER_YAML)
    }

    /// Reads a file like [`PAPER_YAML`].
    ///
    /// # Errors
    /// If it cannot be read, and those of [`Self::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&text_file::read(path)?)
    }

    /// Parses a text like [`PAPER_YAML`].
    ///
    /// # Errors
    /// For a missing or unknown key or placeholder.
    pub fn parse(yaml: &str) -> Result<Self> {
        use Placeholder::{Instruction, PartialCriteria};
        let document: Document = text_file::parse("a file of prompts", yaml)?;
        let SuccessDocument { binary, partial } = document.success;
        Ok(Self {
            binary: Template::parse("success.binary", &binary, &[Instruction])?,
            partial: Template::parse("success.partial", &partial, &[Instruction, PartialCriteria])?,
            rubric: Template::parse("rubric", &document.rubric, &[Instruction])?,
            distractor: Template::parse("distractor", &document.distractor, &[Instruction])?,
        })
    }

    /// The question for success: 0 or 1, or 0, 0.5 or 1 with criteria.
    #[must_use]
    pub fn success(&self, instruction: &str, partial_criteria: Option<&str>) -> String {
        match partial_criteria {
            None => self.binary.fill(instruction, ""),
            Some(criteria) => self.partial.fill(instruction, criteria),
        }
    }

    /// The question for interaction quality, perspectivity and instruction following.
    #[must_use]
    pub fn rubric(&self, instruction: &str) -> String {
        self.rubric.fill(instruction, "")
    }

    /// The prompt of an image editor that adds distractors to a first frame. Judges never get it.
    #[must_use]
    pub fn distractor(&self, instruction: &str) -> String {
        self.distractor.fill(instruction, "")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prompts_match_the_paper() {
        let prompts = Prompts::paper().unwrap();
        let binary = prompts.success("close oven", None);
        assert!(binary.starts_with("Here is a sequence of frames from a robot policy which"));
        assert!(binary.contains(
            "\n\nInstruction: close oven\n\nScore rubric:\n0 = Failure\n1 = Success\n\n"
        ));
        assert!(
            binary.ends_with("Then output exactly one final line:\nFinal Score: X"),
            "{binary}"
        );
        let partial = prompts.success("close oven", Some("half closed"));
        assert!(partial.contains("0 = Failure\n0.5 = Partial: half closed\n1 = Success\n"));
        let rubric = prompts.rubric("close oven");
        for key in crate::judges::verdict::RUBRIC_KEYS {
            assert!(
                rubric.contains(&format!("{key}: ")) && rubric.contains(&format!("\"{key}\": {{"))
            );
        }
        assert!(rubric.contains("human hands") && rubric.contains("at most 2"));
        let distractor = prompts.distractor("close oven");
        assert!(
            distractor.starts_with(
                "This is an initial observation for a robotics task close oven.\nModify"
            )
        );
        assert!(distractor.ends_with("the task close oven should remain achievable."));
    }

    #[test]
    fn instructions_are_never_templates() {
        let prompt = Prompts::paper()
            .unwrap()
            .success("put {partial_criteria} in {cup}", Some("{instruction}"));
        assert!(prompt.contains("Instruction: put {partial_criteria} in {cup}\n"));
        assert!(prompt.contains("Partial: {instruction}\n"));
    }

    #[test]
    fn faulty_files_are_rejected_by_name() {
        let cases = [
            (
                "Instruction: {instruction}\n\n    Score rubric:\n    0 = Failure\n    1",
                "Score: 1",
                "success.binary",
            ),
            ("{partial_criteria}\n", "half\n", "partial_criteria"),
            (
                "a robotics task {instruction}",
                "a robotics task {task_instruction}",
                "{task_instruction}",
            ),
            ("rubric: |", "rubrik: |", "rubrik"),
        ];
        for (from, to, named) in cases {
            let yaml = PAPER_YAML.replace(from, to);
            assert_ne!(yaml, PAPER_YAML);
            let error = Prompts::parse(&yaml).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
