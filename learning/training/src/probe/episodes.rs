use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use rand::{
    Rng,
    seq::{IndexedRandom as _, IteratorRandom as _},
};
use serde::{Deserialize, Serialize};
use wm_dataset::{Episode, Latents};

/// An episode with an instruction and an outcome.
#[derive(Clone, Debug)]
struct LabelledEpisode {
    /// Index among all episodes.
    number: usize,
    first_frame: usize,
    frame_count: usize,
    instruction: String,
    success: bool,
}

impl LabelledEpisode {
    /// The task's family: its verb, which comes first in an English instruction.
    fn family(&self) -> String {
        let verb = self.instruction.split_whitespace().next();
        verb.unwrap_or_default().to_lowercase()
    }
}

/// Whose instructions a success is also asked under.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Negatives {
    /// Those of any episode.
    Any,
    /// Those of another task family, which begin with another verb (the paper, appendix B.7).
    OtherFamily,
}

/// An episode with questions for a probe.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    /// (1, frames, h, w, C).
    pub(super) latents: Tensor,
    /// Index of the episode in the data.
    pub(super) episode: usize,
    /// Index of the first frame in the data.
    pub(super) first_frame: usize,
    /// Number of frames.
    pub(super) frames: usize,
    /// Distance between frames.
    pub(super) frame_skip: usize,
    /// Shift of the latents in places, down and to the right.
    pub(super) shift: [i64; 2],
    pub(super) questions: Vec<Question>,
}

/// A question for a probe, with its answer.
#[derive(Clone, Debug)]
pub(super) struct Question {
    pub(super) instruction: String,
    pub(super) answer: bool,
    /// Whether the instruction belongs to another episode.
    pub(super) is_mismatch: bool,
    /// Weight among the questions on the episode, which sum to one.
    pub(super) weight: f64,
}

/// Shares of the kinds of questions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares {
    /// Of all questions: successes under their own instruction.
    pub(super) successes: f64,
    /// Of the others: successes under another episode's instruction.
    pub(super) mismatches: f64,
    /// Other instructions per success.
    pub(super) others: usize,
}

impl Shares {
    /// For a probe without instructions: outcomes alone.
    pub(super) fn of_outcomes(successes: f64) -> Self {
        Self {
            successes,
            mismatches: 0.0,
            others: 0,
        }
    }
}

/// The episodes with an instruction and an outcome.
pub(super) struct Episodes<'a> {
    latents: &'a Latents,
    frame_skip: usize,
    max_frames: usize,
    labelled: Vec<LabelledEpisode>,
    /// Indices in `labelled`.
    successes: Vec<usize>,
    failures: Vec<usize>,
    /// Indices in `labelled` by family, for [`Negatives::OtherFamily`].
    families: Option<BTreeMap<String, Vec<usize>>>,
}

impl<'a> Episodes<'a> {
    /// From `latents`, reading every `frame_skip`th frame, the newest `max_frames` or all.
    pub(super) fn new(latents: &'a Latents, frame_skip: usize, max_frames: Option<usize>) -> Self {
        let episodes = latents.episodes();
        let numbered = episodes.iter().enumerate();
        let labelled: Vec<LabelledEpisode> = numbered.filter_map(labelled).collect();
        let (successes, failures) = by_outcome(&labelled);
        let longest = labelled.iter().map(|episode| episode.frame_count);
        // Without labelled episodes the probe is not trained.
        let longest = longest.max().unwrap_or(1).div_ceil(frame_skip);
        Self {
            latents,
            frame_skip,
            max_frames: max_frames.unwrap_or(longest),
            labelled,
            successes,
            failures,
            families: None,
        }
    }

    /// The same with these negatives.
    pub(super) fn with(mut self, negatives: Negatives) -> Self {
        self.families = match negatives {
            Negatives::Any => None,
            Negatives::OtherFamily => Some(self.by_family()),
        };
        self
    }

    /// Rejects data without negatives.
    ///
    /// # Errors
    /// If these are of another family, but all instructions are of one.
    pub(super) fn require_negatives(&self) -> Result<()> {
        if let Some(families) = &self.families
            && let (1, Some(verb)) = (families.len(), families.keys().next())
        {
            anyhow::bail!(
                "negatives is other_family, but all instructions begin with `{verb}`: use negatives=any"
            );
        }
        Ok(())
    }

    fn by_family(&self) -> BTreeMap<String, Vec<usize>> {
        let mut families = BTreeMap::<String, Vec<usize>>::new();
        for (place, episode) in self.labelled.iter().enumerate() {
            families.entry(episode.family()).or_default().push(place);
        }
        families
    }

    /// Rejects data that no probe can be trained on.
    ///
    /// # Errors
    /// If no episode has both, or none succeeds.
    pub(super) fn require_successes(&self) -> Result<()> {
        ensure!(
            !self.labelled.is_empty(),
            "none of the {} episodes has both an instruction (/task/instruction) and an outcome (/task/success)",
            self.latents.episodes().len()
        );
        ensure!(
            !self.successes.is_empty(),
            "none of the {} episodes with an outcome is a success",
            self.labelled.len()
        );
        Ok(())
    }

    /// Rejects data for a probe without instructions.
    ///
    /// # Errors
    /// If no episode fails.
    pub(super) fn require_failures(&self) -> Result<()> {
        ensure!(
            !self.failures.is_empty(),
            "none of the {} episodes with an outcome is a failure, and without reading instructions there is nothing else \
             to tell a success from",
            self.labelled.len()
        );
        Ok(())
    }

    /// Excludes episodes by instruction; returns these instructions.
    pub(super) fn leave_out(&mut self, is_out: impl Fn(&str) -> bool) -> Vec<String> {
        let out = self
            .labelled
            .extract_if(.., |episode| is_out(&episode.instruction));
        let out: BTreeSet<String> = out.map(|episode| episode.instruction).collect();
        (self.successes, self.failures) = by_outcome(&self.labelled);
        self.families = self.families.is_some().then(|| self.by_family());
        out.into_iter().collect()
    }

    pub(super) fn len(&self) -> usize {
        self.labelled.len()
    }

    /// Successes and failures.
    pub(super) fn counts(&self) -> [usize; 2] {
        [self.successes.len(), self.failures.len()]
    }

    pub(super) fn max_frames(&self) -> usize {
        self.max_frames
    }

    pub(super) fn instructions(&self) -> impl Iterator<Item = &str> {
        self.labelled.iter().map(|episode| &*episode.instruction)
    }

    /// A random episode. A success has questions under its own instruction and those of other episodes, a failure under its
    /// own; the weights of the questions give all kinds their shares on average.
    pub(super) fn draw(&self, shares: Shares, rng: &mut impl Rng) -> Result<Sample> {
        let mismatches = if self.failures.is_empty() {
            1.0
        } else {
            shares.mismatches
        };
        let of_successes = shares.successes + (1.0 - shares.successes) * mismatches;
        let is_success = rng.random_bool(of_successes.clamp(0.0, 1.0));
        let from = if is_success {
            &self.successes
        } else {
            &self.failures
        };
        let episode = from.choose(rng).and_then(|place| self.labelled.get(*place));
        let Some(episode) = episode else {
            anyhow::bail!("no episode to choose from");
        };
        let offset = rng.random_range(0..self.frame_skip);
        let own = if is_success && shares.others > 0 {
            shares.successes / of_successes
        } else {
            1.0
        };
        let mut questions = vec![question(episode, episode, own)];
        if is_success {
            let weight = (1.0 - own) / shares.others as f64;
            let others = (0..shares.others).filter_map(|_| self.other(episode, rng));
            questions.extend(others.map(|other| question(episode, other, weight)));
        }
        self.sample(episode, questions, offset)
    }

    /// The episode of a negative for `episode`, which may have the same instruction among [`Negatives::Any`].
    fn other(&self, episode: &LabelledEpisode, rng: &mut impl Rng) -> Option<&LabelledEpisode> {
        let Some(families) = &self.families else {
            return self.labelled.choose(rng);
        };
        let own = episode.family();
        let others = families.iter().filter(|(family, _)| **family != own);
        let place = others.flat_map(|(_, places)| places).choose(rng)?;
        self.labelled.get(*place)
    }

    /// Questions of a validation: every episode under its own instruction, and every success also under the next other one
    /// that may be a negative. At most `most` evenly spread episodes.
    pub(super) fn all(&self, most: usize) -> impl Iterator<Item = Result<Sample>> {
        let stride = self.labelled.len().div_ceil(most.max(1)).max(1);
        let asked = self.labelled.iter().enumerate().step_by(stride);
        asked.map(|(place, episode)| {
            let after = self.labelled.iter().cycle().skip(place + 1);
            let mut after = after.take(self.labelled.len());
            let other = after.find(|other| match &self.families {
                None => other.instruction != episode.instruction,
                Some(_) => other.family() != episode.family(),
            });
            let other = other.filter(|_| episode.success);
            let questions = std::iter::once(episode).chain(other);
            let questions = questions.map(|of| question(episode, of, 1.0)).collect();
            self.sample(episode, questions, 0)
        })
    }

    fn sample(
        &self,
        episode: &LabelledEpisode,
        questions: Vec<Question>,
        offset: usize,
    ) -> Result<Sample> {
        let frames = (offset..episode.frame_count).step_by(self.frame_skip);
        let frames: Vec<usize> = frames.collect();
        let newest = frames.len().saturating_sub(self.max_frames);
        let mut values = Vec::new();
        // `newest` is at most the length.
        let frames = frames.get(newest..).unwrap_or_default();
        for frame in frames {
            self.latents
                .read(episode.first_frame + frame, &mut values)?;
        }
        let (h, w, c) = self.latents.space().shape();
        Ok(Sample {
            latents: Tensor::from_vec(values, (1, frames.len(), h, w, c), &Device::Cpu)?,
            episode: episode.number,
            first_frame: episode.first_frame + frames.first().copied().unwrap_or(offset),
            frames: frames.len(),
            frame_skip: self.frame_skip,
            shift: [0; 2],
            questions,
        })
    }
}

/// Whether `episode` follows the instruction of `of`.
fn question(episode: &LabelledEpisode, of: &LabelledEpisode, weight: f64) -> Question {
    // A random other episode may have the same instruction.
    let is_mismatch = of.instruction != episode.instruction;
    Question {
        instruction: of.instruction.clone(),
        answer: episode.success && !is_mismatch,
        is_mismatch,
        weight,
    }
}

/// Indices of successes and of failures.
fn by_outcome(labelled: &[LabelledEpisode]) -> (Vec<usize>, Vec<usize>) {
    (0..labelled.len()).partition(|place| labelled.get(*place).is_some_and(|own| own.success))
}

fn labelled((number, episode): (usize, &Episode)) -> Option<LabelledEpisode> {
    Some(LabelledEpisode {
        number,
        first_frame: episode.first_frame,
        frame_count: episode.frame_count,
        instruction: episode.instruction.clone()?,
        success: episode.success?,
    })
}
