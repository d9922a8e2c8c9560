//! The evaluator's state.

use std::sync::Arc;

use thiserror::Error;
use wm_model::LatentSpace;
use wm_msgs::{
    builtin_interfaces::Time,
    wm_msgs::{Action, ActionCandidates, Latent},
};
use wm_zoo::success_probe::Instruction;

use super::Task;
use crate::{
    planner::Goal,
    predictor::PredictorError,
    timeline::{Arrival, Context, PhysicalAction, Timeline, TimelineError, Timing, Wait, seconds},
};
use wm_wire::latent_message::{LatentError, decode_latent};

/// What can be chosen of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EvaluatorSettings {
    /// Frames that a prediction starts from.
    pub context_frames: usize,
    /// Model steps that are predicted at most.
    pub horizon: usize,
    /// Candidates of one message at most.
    pub max_candidates: usize,
    /// Seed of the noise, the same for all evaluations.
    pub seed: u64,
}

/// Why an input is left out, or there is no assessment.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    /// A latent message that cannot be used.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// A frame or an action that does not fit the timeline.
    #[error(transparent)]
    Timeline(#[from] TimelineError),
    /// No candidate, or too many.
    #[error("{count} candidates; expected 1 to {max}")]
    Count {
        /// Candidates that came.
        count: usize,
        /// Most that are taken.
        max: usize,
    },
    /// A chunk that cannot be used.
    #[error("candidate {index}: {source}")]
    Candidate {
        /// Which one.
        index: usize,
        /// What is wrong with it.
        source: TimelineError,
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
    History(#[from] Wait),
    /// The model cannot compute it.
    #[error(transparent)]
    Predictor(#[from] PredictorError),
    /// The model cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
}

impl From<candle_core::Error> for EvaluatorError {
    fn from(error: candle_core::Error) -> Self {
        Self::Model(error.into())
    }
}

impl EvaluatorError {
    /// One word for the drop counters.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Latent(error) => error.reason(),
            Self::Timeline(error) => error.reason(),
            Self::Candidate {
                source: TimelineError::Ahead { .. },
                ..
            } => "late_candidates",
            Self::Count { .. } | Self::Candidate { .. } => "malformed_candidates",
            Self::Past { .. } => "late_candidates",
            Self::History(_) => "no_history",
            Self::Predictor(_) | Self::Model(_) => "model",
        }
    }
}

/// All that an evaluation is computed from.
#[derive(Clone, Debug)]
pub struct EvaluationRequest {
    /// The policy's name.
    pub policy: String,
    /// Stamp of its message.
    pub candidates_stamp: Time,
    /// Context frames and the actions between them; the last frame is the observation.
    pub context: Context,
    /// Of each candidate, the camera-rate actions of each model step; equally many steps for all.
    pub candidates: Vec<Vec<Vec<PhysicalAction>>>,
    /// What to reach, where that is known.
    pub goal: Option<Goal>,
    /// What to do, where that is known and has been read.
    pub instruction: Option<Arc<Instruction>>,
    /// Seed of the noise.
    pub seed: u64,
    /// How stamps make model steps.
    pub timing: Timing,
}

/// The evaluator node's state: messages in, evaluation requests out.
pub struct EvaluatorStep {
    settings: EvaluatorSettings,
    space: LatentSpace,
    timeline: Timeline,
    goal: Option<Goal>,
    task: Task,
}

impl EvaluatorStep {
    /// An evaluator that has seen nothing.
    pub fn new(settings: EvaluatorSettings, timing: Timing, space: LatentSpace) -> Self {
        Self {
            settings,
            space,
            timeline: Timeline::new(timing, settings.context_frames),
            goal: None,
            task: Task::default(),
        }
    }

    /// Takes a latent.
    ///
    /// # Errors
    /// [`EvaluatorError`]: the latent is left out.
    pub fn latent(&mut self, latent: &Latent) -> Result<Arrival, EvaluatorError> {
        let values: Arc<[f32]> = decode_latent(latent, &self.space)?.into();
        let header = &latent.header;
        Ok(self
            .timeline
            .frame(header.stamp, &header.frame_id, values)?)
    }

    /// Takes an action that was taken.
    ///
    /// # Errors
    /// [`EvaluatorError::Timeline`]: the action is left out.
    pub fn action(&mut self, action: &Action) -> Result<Arrival, EvaluatorError> {
        Ok(self.timeline.action(action)?)
    }

    /// Takes a goal.
    pub fn set_goal(&mut self, goal: Goal) {
        self.goal = Some(goal);
    }

    /// What the policy is asked to do.
    pub fn task_mut(&mut self) -> &mut Task {
        &mut self.task
    }

    /// Takes note that the node's clock jumped back to `now`; whether that flushed the history.
    pub fn clock_jumped(&mut self, now: Time) -> bool {
        self.timeline.clock_jumped(now)
    }

    /// Forgets all history and takes a new seed where one is given; says what was done. Goal and task
    /// stay.
    pub fn reset(&mut self, seed: Option<u64>) -> String {
        self.timeline.clear();
        if let Some(seed) = seed {
            self.settings.seed = seed;
        }
        format!("forgot all frames and actions; seed {}", self.settings.seed)
    }

    /// How stamps make model steps.
    pub fn timing(&self) -> Timing {
        self.timeline.timing()
    }

    /// Whether candidates answer a frame that is still on its way, so that it is better to wait for it: a policy may be
    /// faster than the encoder. Candidates that begin later than the next model step wait for nothing.
    pub fn awaits_frame(&self, message: &ActionCandidates) -> bool {
        let timing = self.timeline.timing();
        let begins = message.chunks.iter().map(|chunk| chunk.header.stamp);
        let Some((begin, newest)) = begins.max().zip(self.timeline.newest()) else {
            return false;
        };
        let ahead_ns = begin.to_nanos().saturating_sub(newest.stamp_ns);
        ahead_ns > timing.tolerance_ns && ahead_ns <= timing.step_ns()
    }

    /// The evaluation of candidates from the newest frame on. As many whole model steps are predicted as the shortest
    /// candidate speaks of, and at least one, so that all are compared at one moment.
    ///
    /// # Errors
    /// [`EvaluatorError`] names the candidate that cannot be used, or what is missing.
    pub fn candidates(
        &self,
        message: &ActionCandidates,
    ) -> Result<EvaluationRequest, EvaluatorError> {
        let (count, max) = (message.chunks.len(), self.settings.max_candidates);
        if count == 0 || count > max {
            return Err(EvaluatorError::Count { count, max });
        }
        let timing = self.timeline.timing();
        let observed_ns = self.timeline.newest().ok_or(Wait::NoFrame)?.stamp_ns;
        let mut horizon = self.settings.horizon;
        // A handful of steps.
        let beyond_ns = observed_ns.saturating_add(timing.step_ns() * horizon as i64);
        let mut timelines = Vec::with_capacity(count);
        for (index, chunk) in message.chunks.iter().enumerate() {
            let mut timeline = self.timeline.clone();
            let wrong = |source| EvaluatorError::Candidate { index, source };
            timeline.chunk(chunk).map_err(wrong)?;
            let stamp_ns = chunk.header.stamp.to_nanos();
            if stamp_ns >= beyond_ns {
                return Err(wrong(TimelineError::Ahead {
                    stamp_ns,
                    newest_ns: observed_ns,
                }));
            }
            // The timeline has refused what is longer than MAX_CHUNK or has no period.
            let span_ns = chunk
                .period
                .to_nanos()
                .saturating_mul(chunk.actions.len() as i64);
            let end_ns = chunk.header.stamp.to_nanos().saturating_add(span_ns);
            let left_ns = end_ns.saturating_sub(observed_ns);
            if left_ns <= timing.tolerance_ns {
                return Err(EvaluatorError::Past { index, observed_ns });
            }
            // A stamp that is a jitter early is of the step all the same.
            let steps = left_ns.saturating_add(timing.tolerance_ns) / timing.step_ns().max(1);
            horizon = horizon.min(usize::try_from(steps.max(1)).unwrap_or(usize::MAX));
            timelines.push(timeline);
        }
        let future = |timeline: &Timeline| {
            let starts = (0..horizon).map(|step| observed_ns + timing.step_ns() * step as i64);
            starts
                .map(|start_ns| timeline.actions_of_step(start_ns))
                .collect::<Result<_, _>>()
        };
        let context = match timelines.first() {
            // A chunk may say what was done where an action itself is missing.
            Some(first) => first.context()?,
            None => self.timeline.context()?,
        };
        Ok(EvaluationRequest {
            policy: message.policy.clone(),
            candidates_stamp: message.header.stamp,
            context,
            candidates: timelines.iter().map(future).collect::<Result<_, _>>()?,
            goal: self.goal.clone(),
            instruction: self.task.instruction(),
            seed: self.settings.seed,
            timing,
        })
    }
}

#[cfg(test)]
mod tests;
