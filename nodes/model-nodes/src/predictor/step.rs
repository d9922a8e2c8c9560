//! The predictor's state.

use std::sync::Arc;

use wm_model::LatentSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent, PredictionError},
};

use super::{
    PredictedStep, PredictorError, RolloutRequest,
    scoring::{Pending, Scoring},
};
use crate::timeline::{Arrival, ChunkMerging, Timeline, Timing, Wait};
use wm_wire::latent_message::{LatentDtype, decode_latent};

/// What can be chosen of a rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PredictorSettings {
    /// Model steps K of a rollout.
    pub horizon: usize,
    /// Frames that a rollout starts from.
    pub context_frames: usize,
    /// Euler steps a predicted frame.
    pub integration_steps: usize,
    /// Seed of the noise; the same for every rollout, so that a prediction does not depend on how many came before.
    pub seed: u64,
    /// Type of the numbers in the messages.
    pub dtype: LatentDtype,
}

/// What a latent brought about.
#[derive(Debug)]
pub struct LatentOutcome {
    /// What it did to the timeline.
    pub arrival: Arrival,
    /// How the predictions of its moment did.
    pub errors: Vec<PredictionError>,
    /// The rollout that starts from it, or what that waits for.
    pub rollout: Result<RolloutRequest, Wait>,
}

/// The predictor node's state: messages in, rollout requests and prediction errors out.
#[derive(Clone, Debug)]
pub struct PredictorStep {
    settings: PredictorSettings,
    space: LatentSpace,
    timeline: Timeline,
    scoring: Scoring,
}

impl PredictorStep {
    /// A predictor that has seen nothing.
    pub fn new(settings: PredictorSettings, timing: Timing, space: LatentSpace) -> Self {
        let mut step = Self {
            settings,
            space,
            timeline: Timeline::new(timing, settings.context_frames),
            scoring: Scoring::default(),
        };
        step.set(settings.horizon, settings.integration_steps);
        step
    }

    /// The same predictor, which merges overlapping chunks by `merging`.
    #[must_use]
    pub fn with_chunk_merging(mut self, merging: ChunkMerging) -> Self {
        self.timeline = self.timeline.with_chunk_merging(merging);
        self
    }

    /// Takes a latent, received at `received` by the node's clock.
    ///
    /// # Errors
    /// [`PredictorError`]: the latent is left out, the state is as before.
    pub fn latent(
        &mut self,
        latent: &Latent,
        received: Time,
    ) -> Result<LatentOutcome, PredictorError> {
        let values: Arc<[f32]> = decode_latent(latent, &self.space)?.into();
        let arrival = self
            .timeline
            .frame(latent.header.stamp, &latent.header.frame_id, values)?;
        if arrival.flushed {
            self.scoring.clear();
        }
        let tolerance_ns = self.timeline.timing().tolerance_ns;
        let errors = match self.timeline.newest() {
            Some(seen) => self.scoring.seen(seen, tolerance_ns),
            None => Vec::new(),
        };
        Ok(LatentOutcome {
            arrival,
            errors,
            rollout: self.request(received),
        })
    }

    /// Takes an action that was taken.
    ///
    /// # Errors
    /// [`PredictorError::Timeline`]: the action is left out.
    pub fn action(&mut self, action: &Action) -> Result<Arrival, PredictorError> {
        let arrival = self.timeline.action(action)?;
        if arrival.flushed {
            self.scoring.clear();
        }
        Ok(arrival)
    }

    /// Takes the actions to come.
    ///
    /// # Errors
    /// [`PredictorError::Timeline`]: the chunk is left out, the one before stays.
    pub fn chunk(&mut self, chunk: &ActionChunk) -> Result<(), PredictorError> {
        Ok(self.timeline.chunk(chunk)?)
    }

    /// Takes note of a prediction that was made. Where its moment has come already, its error is returned at once.
    /// One of an earlier epoch is ignored.
    pub fn predicted(&mut self, step: &PredictedStep) -> Option<PredictionError> {
        if step.epoch != self.epoch() {
            return None;
        }
        let due_ns = step.prediction.header.stamp.to_nanos();
        let pending = Pending {
            due_ns,
            observed: step.observed.clone(),
            step: step.prediction.step,
            predicted: Arc::clone(&step.values),
        };
        let tolerance_ns = self.timeline.timing().tolerance_ns;
        self.scoring
            .add(pending, self.timeline.near(due_ns, tolerance_ns))
    }

    /// Forgets all history and takes a new seed where one is given; says what was done.
    pub fn reset(&mut self, seed: Option<u64>) -> String {
        self.flush();
        if let Some(seed) = seed {
            self.settings.seed = seed;
        }
        format!(
            "forgot all frames, actions and open predictions; seed {}",
            self.settings.seed
        )
    }

    /// Forgets all history.
    fn flush(&mut self) {
        self.timeline.clear();
        self.scoring.clear();
    }

    /// Takes note that the node's clock jumped back to `now`; whether that flushed the history.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let has_flushed = self.timeline.clock_jumped(now);
        if has_flushed {
            self.scoring.clear();
        }
        has_flushed
    }

    /// Predictions that were given up before their moment came, since too many waited.
    pub fn unscored(&self) -> u64 {
        self.scoring.given_up()
    }

    /// Settings of the next rollouts. The number of context frames is fixed when the state is made.
    pub fn set(&mut self, horizon: usize, integration_steps: usize) {
        self.settings.horizon = horizon;
        let skip = self.timeline.timing().frame_skip;
        self.scoring.make_room(horizon, skip);
        self.settings.integration_steps = integration_steps;
    }

    /// Counts up with every flush.
    pub fn epoch(&self) -> u64 {
        self.timeline.epoch()
    }

    fn request(&self, received: Time) -> Result<RolloutRequest, Wait> {
        let context = self.timeline.context()?;
        let timing = self.timeline.timing();
        let observed_ns = context.frames.last().ok_or(Wait::NoFrame)?.stamp_ns;
        // Horizons are a handful of steps.
        let future = (0..self.settings.horizon)
            .map(|step| {
                self.timeline
                    .actions_of_step(observed_ns + timing.step_ns() * step as i64)
            })
            .collect::<Result<_, _>>()?;
        Ok(RolloutRequest {
            epoch: self.epoch(),
            context,
            future,
            received,
            seed: self.settings.seed,
            integration_steps: self.settings.integration_steps,
            dtype: self.settings.dtype,
            timing,
        })
    }
}

#[cfg(test)]
mod tests;
