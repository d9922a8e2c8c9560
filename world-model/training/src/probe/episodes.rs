use std::collections::BTreeSet;

use anyhow::{Result, ensure};
use candle_core::{Device, Tensor};
use rand::{Rng, seq::IndexedRandom as _};

use crate::{dataset::Episode, latents::Latents};

/// An episode that shows whether its instruction was carried out.
#[derive(Clone, Debug)]
struct Labelled {
    first_frame: usize,
    frame_count: usize,
    instruction: String,
    success: bool,
}

/// What a probe is asked, and the answer.
#[derive(Clone, Debug)]
pub(super) struct Question {
    /// (1, T, h, w, C).
    pub(super) latents: Tensor,
    pub(super) instruction: String,
    pub(super) answer: bool,
    /// Whether the instruction is another episode's.
    pub(super) is_mismatch: bool,
}

/// The episodes with an instruction and an outcome.
pub(super) struct Episodes<'a> {
    latents: &'a Latents,
    frame_skip: usize,
    max_frames: usize,
    labelled: Vec<Labelled>,
    /// By their places in `labelled`.
    successes: Vec<usize>,
    failures: Vec<usize>,
}

impl<'a> Episodes<'a> {
    /// Of `latents`, of whose frames every `frame_skip`th is read, the newest `max_frames` at most; all without it.
    pub(super) fn new(latents: &'a Latents, frame_skip: usize, max_frames: Option<usize>) -> Self {
        let episodes = latents.episodes();
        let labelled: Vec<Labelled> = episodes.iter().filter_map(labelled).collect();
        let (successes, failures) = by_outcome(&labelled);
        let longest = labelled.iter().map(|episode| episode.frame_count);
        let longest = longest.max().unwrap_or(1).div_ceil(frame_skip);
        Self {
            latents,
            frame_skip,
            max_frames: max_frames.unwrap_or(longest),
            labelled,
            successes,
            failures,
        }
    }

    /// Refuses data that a probe cannot be trained on.
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

    /// Leaves out the episodes whose instruction is to be; gives these instructions.
    pub(super) fn leave_out(&mut self, is_out: impl Fn(&str) -> bool) -> Vec<String> {
        let out = self
            .labelled
            .extract_if(.., |episode| is_out(&episode.instruction));
        let out: BTreeSet<String> = out.map(|episode| episode.instruction).collect();
        (self.successes, self.failures) = by_outcome(&self.labelled);
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

    /// A random question: a success in a share `successes` of the cases; of the others a share `mismatches` is a
    /// success under another episode's instruction, and the rest are failures.
    pub(super) fn draw(
        &self,
        successes: f64,
        mismatches: f64,
        rng: &mut impl Rng,
    ) -> Result<Question> {
        let is_success = rng.random_bool(successes);
        let is_mismatch = rng.random_bool(mismatches) || self.failures.is_empty();
        let from = if is_success || is_mismatch {
            &self.successes
        } else {
            &self.failures
        };
        let episode = from.choose(rng).and_then(|place| self.labelled.get(*place));
        let other = (!is_success && is_mismatch).then(|| self.labelled.choose(rng));
        let offset = rng.random_range(0..self.frame_skip);
        let Some(episode) = episode else {
            anyhow::bail!("no episode to choose from");
        };
        self.question(episode, other.flatten(), offset)
    }

    /// What is asked for a validation: every episode under its own instruction, and every success under that of the
    /// next episode with another one. At most `most`, spread over all.
    pub(super) fn all(&self, most: usize) -> impl Iterator<Item = Result<Question>> {
        let own = self.labelled.iter().map(|episode| (episode, None));
        let successes = self.successes.iter();
        let mismatched = successes.filter_map(|place| {
            let episode = self.labelled.get(*place)?;
            let after = self.labelled.iter().cycle().skip(*place + 1);
            let mut after = after.take(self.labelled.len());
            let other = after.find(|other| other.instruction != episode.instruction)?;
            Some((episode, Some(other)))
        });
        let count = self.labelled.len() + self.successes.len();
        let stride = count.div_ceil(most.max(1)).max(1);
        let asked = own.chain(mismatched).step_by(stride);
        asked.map(|(episode, other)| self.question(episode, other, 0))
    }

    fn question(
        &self,
        episode: &Labelled,
        other: Option<&Labelled>,
        offset: usize,
    ) -> Result<Question> {
        let frames = (offset..episode.frame_count).step_by(self.frame_skip);
        let frames: Vec<usize> = frames.collect();
        let newest = frames.len().saturating_sub(self.max_frames);
        let mut values = Vec::new();
        let frames = frames.get(newest..).unwrap_or_default();
        for frame in frames {
            self.latents
                .read(episode.first_frame + frame, &mut values)?;
        }
        let (h, w, c) = self.latents.space().shape();
        let of = other.unwrap_or(episode);
        // Drawn by chance, another episode may have the same instruction.
        let is_mismatch = of.instruction != episode.instruction;
        Ok(Question {
            latents: Tensor::from_vec(values, (1, frames.len(), h, w, c), &Device::Cpu)?,
            instruction: of.instruction.clone(),
            answer: episode.success && !is_mismatch,
            is_mismatch,
        })
    }
}

/// The places of successes and of failures.
fn by_outcome(labelled: &[Labelled]) -> (Vec<usize>, Vec<usize>) {
    (0..labelled.len()).partition(|place| labelled.get(*place).is_some_and(|own| own.success))
}

fn labelled(episode: &Episode) -> Option<Labelled> {
    Some(Labelled {
        first_frame: episode.first_frame,
        frame_count: episode.frame_count,
        instruction: episode.instruction.clone()?,
        success: episode.success?,
    })
}
