//! The predictor's state.

use std::{collections::BTreeMap, sync::Arc};

use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionChunk, Latent, PredictionError},
};
use wm_wire::latent_message::LatentDtype;

use super::{
    CalibrationSettings, Doubt, Fit, PredictedStep, RolloutRequest, Trust,
    calibration::Calibration,
    scoring::{Pending, Scored, Scoring},
};
use crate::{
    harness::follows,
    history::{Ahead, Arrival, History, HistoryError, Reception, Wait},
};

/// Settings of a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictorSettings {
    /// Model steps K of a rollout.
    pub horizon: usize,
    /// Euler steps per predicted frame.
    pub integration_steps: usize,
    /// Seed of the noise; the same for every rollout, so that a prediction does not depend on how many came before.
    pub seed: u64,
    /// Type of the numbers in the messages.
    pub dtype: LatentDtype,
    /// How predicted motion is scaled; `None`: not at all.
    pub calibration: Option<CalibrationSettings>,
}

/// The effects of an input.
#[derive(Debug)]
pub struct Outcome {
    /// The effect on the history.
    pub arrival: Arrival,
    /// The errors of the predictions of this time.
    pub errors: Vec<PredictionError>,
    /// The rollout that is due, or the reason for waiting; `None` if none is due.
    pub rollout: Option<Result<RolloutRequest, Wait>>,
}

/// The results of a latent: the errors of the predictions of its time, and a rollout or the reason for waiting.
pub(super) type LatentEffect = (Vec<PredictionError>, Option<Result<RolloutRequest, Wait>>);

/// The predictor node's state: messages in, rollout requests and prediction errors out.
#[derive(Clone, Debug)]
pub struct PredictorStep {
    settings: PredictorSettings,
    history: History,
    scoring: Scoring,
    trust: Trust,
    calibration: Option<Calibration>,
    /// The newest ratio of each k.
    ratios: BTreeMap<u32, f32>,
}

follows!(
    PredictorStep,
    LatentEffect,
    |outcome| (outcome.arrival, (outcome.errors, outcome.rollout)),
    RolloutRequest,
    |outcome| (outcome.arrival, outcome.rollout.and_then(Result::ok))
);

impl PredictorStep {
    /// A predictor over an empty `history`.
    pub fn new(settings: PredictorSettings, history: History) -> Self {
        let mut step = Self {
            settings,
            history,
            scoring: Scoring::default(),
            trust: Trust::default(),
            calibration: settings.calibration.map(Calibration::new),
            ratios: BTreeMap::new(),
        };
        step.set(settings.horizon, settings.integration_steps);
        step
    }

    /// Continues from the state of the model `before`, and returns a rollout from its newest frame if its latents and
    /// actions are this model's. Errors of its predictions are not this model's: they are forgotten.
    pub fn continue_from(&mut self, before: &Self, now: Time) -> Option<RolloutRequest> {
        self.settings.seed = before.settings.seed;
        let is_same = self.history.continue_from(&before.history, now);
        is_same.then(|| self.request().ok()).flatten()
    }

    /// Takes a latent.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped, and the state does not change.
    pub fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<Outcome, HistoryError> {
        let arrival = self.history.latent(latent, reception)?;
        if arrival.flushed {
            self.forget();
        }
        let tolerance_ns = self.history.timing().tolerance_ns;
        let scored = match self.history.newest() {
            Some(seen) if !arrival.held_back => self.scoring.seen(seen, tolerance_ns),
            _ => Vec::new(),
        };
        if let Some(seen) = self.history.newest().filter(|_| !arrival.held_back) {
            self.trust.seen(seen);
        }
        let errors = scored
            .into_iter()
            .map(|scored| self.scored(scored))
            .collect();
        let is_due = arrival.is_due && !arrival.held_back;
        let rollout = match is_due.then(|| self.request()) {
            // The next frames complete it: not worth a report.
            Some(Err(_)) if self.history.is_between_contexts() => None,
            rollout => rollout,
        };
        Ok(Outcome {
            rollout,
            arrival,
            errors,
        })
    }

    /// Takes an action of the robot.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
        self.history.action(action, now)
    }

    /// Takes a chunk of coming actions. If it answers the newest frame, that frame's rollout is due again, because a
    /// policy may be slower than the encoder.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped, and the previous one stays.
    pub fn chunk(&mut self, chunk: &ActionChunk, now: Time) -> Result<Outcome, HistoryError> {
        let arrival = self.history.chunk(chunk, now)?;
        let rollout = match arrival.is_due.then(|| self.request()) {
            // The missing parts were reported with the frame.
            Some(Err(_)) | None => None,
            request => request,
        };
        Ok(Outcome {
            arrival,
            errors: Vec::new(),
            rollout,
        })
    }

    /// Records a prediction. If the frame of its time has already arrived, its error is returned at once. One of an
    /// earlier epoch is ignored.
    pub fn predicted(&mut self, step: &PredictedStep) -> Option<PredictionError> {
        if step.prediction.epoch != self.epoch() {
            return None;
        }
        let due_ns = step.prediction.header.stamp.to_nanos();
        let pending = Pending {
            due_ns,
            observed: step.observed.clone(),
            step: step.prediction.step,
            predicted: Arc::clone(&step.values),
            factor: step.factor,
        };
        let scored = self.scoring.add(pending, self.history.near(due_ns))?;
        Some(self.scored(scored))
    }

    /// The calibration of each step of a rollout of `horizon` steps from the observation of `observed_ns`; empty without
    /// calibration. Call it when the rollout begins: all earlier ones are then recorded, so the same messages give the
    /// same factors.
    pub fn fits(&self, horizon: usize, observed_ns: i64) -> Vec<Fit> {
        let Some(calibration) = &self.calibration else {
            return Vec::new();
        };
        let steps = (1..).take(horizon);
        steps.map(|k| calibration.fit(k, observed_ns)).collect()
    }

    /// The context of an observation that is expected at `stamp_ns`.
    pub fn ahead(&self, stamp_ns: i64) -> Option<Ahead> {
        self.history.ahead(stamp_ns)
    }

    /// Clears the history and takes a new seed if one is given; returns a description.
    pub fn reset(&mut self, seed: Option<u64>, now: Time) -> String {
        self.history.reset(now);
        self.forget();
        if let Some(seed) = seed {
            self.settings.seed = seed;
        }
        format!(
            "forgot all frames, actions and open predictions; seed {}",
            self.settings.seed
        )
    }

    /// Handles a jump of the node's clock back to `now`; returns whether the history was flushed.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        let has_flushed = self.history.clock_jumped(now);
        if has_flushed {
            self.forget();
        }
        has_flushed
    }

    fn scored(&mut self, scored: Scored) -> PredictionError {
        let Scored {
            error,
            comparison,
            seen_ns,
        } = scored;
        if let Some(calibration) = &mut self.calibration {
            calibration.add(error.step, seen_ns, comparison);
        }
        // The model is judged, not its calibration.
        self.trust.scored(&error, comparison.error(1.0));
        self.ratios.insert(error.step, error.ratio);
        error
    }

    /// The newest error ratio of each k that is known.
    pub(super) fn ratios(&self) -> &BTreeMap<u32, f32> {
        &self.ratios
    }

    fn forget(&mut self) {
        self.ratios.clear();
        self.scoring.clear();
        self.trust.clear();
        if let Some(calibration) = &mut self.calibration {
            calibration.clear();
        }
    }

    /// Figures of the predictions' quality over the last seconds.
    pub(super) fn trust(&self) -> &Trust {
        &self.trust
    }

    /// Reasons to doubt the predictions of the last seconds.
    pub fn doubt(&self) -> Option<Doubt> {
        let step = self.history.camera_step();
        step.map(Doubt::CameraClock).or_else(|| self.trust.doubt())
    }

    /// Predictions dropped before their frame arrived, because too many waited.
    pub fn unscored(&self) -> u64 {
        self.scoring.given_up()
    }

    /// Settings of the next rollouts.
    pub fn set(&mut self, horizon: usize, integration_steps: usize) {
        self.settings.horizon = horizon;
        let skip = self.history.timing().frame_skip;
        self.scoring.make_room(horizon, skip);
        self.settings.integration_steps = integration_steps;
    }

    /// Counts up with every flush.
    pub fn epoch(&self) -> u64 {
        self.history.epoch()
    }

    fn request(&self) -> Result<RolloutRequest, Wait> {
        Ok(RolloutRequest {
            moment: self.history.moment()?,
            // One more than is predicted: the last frame carries the action after it.
            future: self.history.future(self.settings.horizon + 1)?,
            horizon: self.settings.horizon,
            seed: self.settings.seed,
            integration_steps: self.settings.integration_steps,
            dtype: self.settings.dtype,
        })
    }
}

#[cfg(test)]
mod tests;
