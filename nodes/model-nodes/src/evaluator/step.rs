//! The evaluator's state.

use std::{
    convert::Infallible,
    sync::Arc,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_motion::motion::StepAction;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionCandidates, ActionChunk, Latent},
};
use wm_zoo::success_probe::Instruction;

use super::Task;
use crate::{
    harness::follows,
    history::{
        Arrival, FROZEN_CAMERA, History, HistoryError, Moment, Reception, Timing, Wait, seconds,
        stamp_of_other,
    },
    planner::Goal,
    predictor::PredictorError,
};
use wm_wire::latent_message::LatentError;

/// Settings of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvaluatorSettings {
    /// Greatest age of the newest frame, by when it was received.
    pub max_age: Duration,
    /// Model steps that are predicted at most.
    pub horizon: usize,
    /// Candidates of one message at most.
    pub max_candidates: usize,
    /// Seed of the noise, the same for all evaluations.
    pub seed: u64,
}

/// Why an input is dropped, or there is no assessment.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    /// A predicted latent that is not finite.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// No candidate, or too many.
    #[error("{count} candidates; expected 1 to {max}")]
    Count {
        /// Candidates that came.
        count: usize,
        /// Most that are taken.
        max: usize,
    },
    /// A message with an invalid stamp.
    #[error(transparent)]
    Stamp(#[from] HistoryError),
    /// A chunk that cannot be used.
    #[error("candidate {index}: {source}")]
    Candidate {
        /// Which one.
        index: usize,
        /// The fault.
        source: HistoryError,
    },
    /// All of a chunk lies before the observed frame.
    #[error("candidate {index} ends before the observed frame of {}: stamp it with the stamp of the image that it answers", seconds(Time::from_nanos(*.observed_ns)))]
    Past {
        /// Which one.
        index: usize,
        /// Stamp of the frame \[ns\].
        observed_ns: i64,
    },
    /// The history is not complete.
    #[error(transparent)]
    Waiting(#[from] Wait),
    /// The model cannot compute it.
    #[error(transparent)]
    Predictor(#[from] PredictorError),
    /// The model cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
}

impl EvaluatorError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Latent(error) => error.reason(),
            Self::Candidate {
                source: HistoryError::Ahead { .. } | HistoryError::OutOfOrder { .. },
                ..
            } => "late_candidates",
            Self::Stamp(error) => error.reason(),
            Self::Count { .. } | Self::Candidate { .. } => "malformed_candidates",
            Self::Past { .. } => "late_candidates",
            Self::Waiting(Wait::Frozen) => FROZEN_CAMERA,
            Self::Waiting(Wait::CameraClock(_)) => "camera_clock",
            Self::Waiting(_) => "no_history",
            Self::Predictor(_) | Self::Model(_) => "model",
        }
    }
}

/// The inputs of an evaluation.
#[derive(Clone, Debug)]
pub struct EvaluationRequest {
    /// The policy's name.
    pub policy: String,
    /// Stamp of its message.
    pub candidates_stamp: Time,
    /// The observation.
    pub moment: Moment,
    /// The actions of each candidate for each predicted model step, and for one more.
    pub candidates: Vec<Vec<StepAction>>,
    /// Model steps to predict.
    pub horizon: usize,
    /// The goal, if there is one.
    pub goal: Option<Goal>,
    /// The instruction, if there is one and it has been encoded.
    pub instruction: Option<Arc<Instruction>>,
    /// Seed of the noise.
    pub seed: u64,
}

/// The evaluator node's state: messages in, evaluation requests out.
pub struct EvaluatorStep {
    settings: EvaluatorSettings,
    history: History,
    goal: Option<Goal>,
    task: Task,
}

follows!(
    EvaluatorStep,
    (),
    |arrival| (arrival, ()),
    Infallible,
    |arrival| (arrival, None)
);

impl EvaluatorStep {
    /// An evaluator over an empty `history`.
    pub fn new(settings: EvaluatorSettings, history: History) -> Self {
        Self {
            settings,
            history,
            goal: None,
            task: Task::default(),
        }
    }

    /// Continues from the state of the model `before`, whose goal is kept if its latents and actions are this model's. The
    /// task is read again by the new model's probe. Returns whether they are this model's.
    pub fn continue_from(&mut self, before: &Self, now: Time) -> bool {
        let is_same = self.history.continue_from(&before.history, now);
        if is_same {
            self.goal.clone_from(&before.goal);
        }
        is_same
    }

    /// Takes a latent.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn latent(
        &mut self,
        latent: &Latent,
        reception: Reception,
    ) -> Result<Arrival, HistoryError> {
        self.history.latent(latent, reception)
    }

    /// Takes an action of the robot.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn action(&mut self, action: &Action, now: Time) -> Result<Arrival, HistoryError> {
        self.history.action(action, now)
    }

    /// Takes the current chunk: what the robot does before a candidate begins.
    ///
    /// # Errors
    /// [`HistoryError`]: it is dropped.
    pub fn chunk(&mut self, chunk: &ActionChunk, now: Time) -> Result<Arrival, HistoryError> {
        self.history.chunk(chunk, now)
    }

    /// Takes a goal.
    pub fn set_goal(&mut self, goal: Goal) {
        self.goal = Some(goal);
    }

    /// Whether a goal is set.
    pub fn has_goal(&self) -> bool {
        self.goal.is_some()
    }

    /// The policy's task.
    pub fn task_mut(&mut self) -> &mut Task {
        &mut self.task
    }

    /// Handles a jump of the node's clock back to `now`; returns whether the history was flushed.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        self.history.clock_jumped(now)
    }

    /// Clears the history and takes a new seed if one is given; returns a description. Goal and task stay.
    pub fn reset(&mut self, seed: Option<u64>, now: Time) -> String {
        self.history.reset(now);
        if let Some(seed) = seed {
            self.settings.seed = seed;
        }
        format!("forgot all frames and actions; seed {}", self.settings.seed)
    }

    /// The history's epoch: results of an earlier epoch are out of date.
    pub fn epoch(&self) -> u64 {
        self.history.epoch()
    }

    /// How stamps are grouped into model steps.
    pub fn timing(&self) -> Timing {
        self.history.timing()
    }

    /// Whether candidates answer a frame that has not arrived yet, because the policy is faster than the encoder.
    /// Candidates that begin later than the next model step do not wait.
    pub fn awaits_frame(&self, message: &ActionCandidates) -> bool {
        let timing = self.history.timing();
        let begins = message.chunks.iter().map(|chunk| chunk.header.stamp);
        let Some((begin, newest)) = begins.max().zip(self.history.newest()) else {
            return false;
        };
        let ahead_ns = begin.to_nanos().saturating_sub(newest.stamp_ns);
        ahead_ns > timing.tolerance_ns && ahead_ns <= timing.step_ns()
    }

    /// The evaluation of candidates from the newest frame on, at `now` (`clock` by the node's clock). As many whole model
    /// steps are predicted as the shortest candidate speaks of, and at least one, so that all are compared at one moment.
    ///
    /// # Errors
    /// [`EvaluatorError`] names the candidate that cannot be used, or what is missing.
    pub fn candidates(
        &self,
        message: &ActionCandidates,
        now: Instant,
        clock: Time,
    ) -> Result<EvaluationRequest, EvaluatorError> {
        let (count, max) = (message.chunks.len(), self.settings.max_candidates);
        if count == 0 || count > max {
            return Err(EvaluatorError::Count { count, max });
        }
        stamp_of_other("candidates message", message.header.stamp)?;
        let timing = self.history.timing();
        let observed_ns = self.history.latest().ok_or(Wait::NoFrame)?.stamp_ns;
        let mut horizon = self.settings.horizon;
        let beyond_ns = timing.step_at(observed_ns, horizon);
        let mut histories = Vec::with_capacity(count);
        for (index, chunk) in message.chunks.iter().enumerate() {
            let mut history = self.history.clone();
            let wrong = |source| EvaluatorError::Candidate { index, source };
            if history.chunk(chunk, clock).map_err(wrong)?.held_back {
                return Err(EvaluatorError::Past { index, observed_ns });
            }
            let stamp_ns = chunk.header.stamp.to_nanos();
            if stamp_ns >= beyond_ns {
                return Err(wrong(HistoryError::Ahead {
                    what: "action chunk",
                    stamp_ns,
                    newest_ns: observed_ns,
                }));
            }
            // The history has refused what is too long or has no period.
            let span_ns = chunk
                .period
                .to_nanos()
                .saturating_mul(chunk.actions.len() as i64);
            let end_ns = stamp_ns.saturating_add(span_ns);
            let left_ns = end_ns.saturating_sub(observed_ns);
            if left_ns <= timing.tolerance_ns {
                return Err(EvaluatorError::Past { index, observed_ns });
            }
            // A stamp that is slightly early belongs to the step.
            let steps = left_ns.saturating_add(timing.tolerance_ns) / timing.step_ns().max(1);
            // More steps than memory holds are no limit.
            horizon = horizon.min(usize::try_from(steps.max(1)).unwrap_or(usize::MAX));
            histories.push(history);
        }
        // One more than is predicted: the last frame carries the action after it.
        let future = |history: &History| history.future_from(observed_ns, horizon + 1);
        let candidates = histories.iter().map(future);
        let candidates = candidates.collect::<Result<_, _>>()?;
        // If an action is missing, a chunk may contain it.
        let moment = match histories.first() {
            Some(first) => first.latest_moment()?,
            None => self.history.latest_moment()?,
        };
        moment.expect_fresh(now, self.settings.max_age)?;
        Ok(EvaluationRequest {
            policy: message.policy.clone(),
            candidates_stamp: message.header.stamp,
            moment,
            candidates,
            horizon,
            goal: self.goal.clone(),
            instruction: self.task.instruction(),
            seed: self.settings.seed,
        })
    }
}

#[cfg(test)]
mod tests;
