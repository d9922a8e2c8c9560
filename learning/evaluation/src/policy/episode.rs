//! Runs one imagined episode: the policy acts, the world model predicts.

use std::collections::VecDeque;

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::sampler::{Given, Rollout};
use wm_motion::actions::{ActionEncoding, ActionSpace};

use super::{
    protocol::{ActionSpaceInfo, Request, VERSION, actions},
    setup::Policy,
};
use crate::{Subject, picture_strip::png};

/// Start of an episode.
#[derive(Clone, Debug)]
pub(super) struct Start {
    /// (1, `CONTEXT`, h, w, C).
    pub latents: Tensor,
    /// (`CONTEXT` - 1, A): the model actions between them.
    pub past: Tensor,
    /// The newest frame.
    pub picture: RgbImage,
    /// The last action before the newest frame.
    pub last: Vec<f32>,
    /// The recorded actions from there on.
    pub recorded: Vec<Vec<f32>>,
}

/// Identity of a trial, for the policy.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<'a> {
    pub task: &'a str,
    pub trial: usize,
    pub seed: u64,
    pub instruction: &'a str,
}

/// An imagined episode.
#[derive(Clone, Debug)]
pub(super) struct Episode {
    /// Observed, then predicted: (`CONTEXT` + steps, h, w, C).
    pub latents: Tensor,
    /// The newest observed frame, then decoded predictions; empty if unused.
    pub pictures: Vec<RgbImage>,
    /// Clipped values of actions.
    pub clipped: usize,
    /// Values of all actions.
    pub values: usize,
}

/// Runs a policy for some model steps. `is_seen`: whether to decode predictions even for a blind policy.
///
/// # Errors
/// If the policy fails, or model and start do not fit.
pub(super) fn imagine(
    subject: &Subject,
    policy: &Policy,
    start: &Start,
    trial: Trial<'_>,
    (steps, is_seen): (usize, bool),
) -> Result<Episode> {
    let encoding = &subject.world.encoding;
    let skip = encoding.frame_skip();
    let space = ActionSpaceInfo::of(encoding);
    let mut actor = Actor::new(policy, encoding, start);
    let is_seen = is_seen || matches!(policy, Policy::Command(_));
    let (model, sampler) = (&subject.world.transition, subject.sampler());
    let mut rollout = Rollout::new(
        model,
        sampler,
        &start.latents,
        Some(&start.past),
        trial.seed,
    )?;
    let mut latents = vec![start.latents.squeeze(0)?];
    let mut pictures = Vec::new();
    if is_seen {
        pictures.push(start.picture.clone());
    }
    let (mut clipped, mut values) = (0, 0);
    for step in 0..steps {
        let failed = || {
            let Trial { task, trial, .. } = trial;
            format!("the policy, task {task}, trial {trial}, step {step}")
        };
        if actor.needs_actions() {
            let seen = pictures.last().context("a picture for the policy")?;
            let request = Request {
                version: VERSION,
                task: trial.task,
                trial: trial.trial,
                seed: trial.seed,
                step,
                instruction: trial.instruction,
                image: png(seen)?,
                views: subject.dataset.views(),
                state: None,
                action_space: &space,
            };
            actor.request(&request).with_context(failed)?;
        }
        let (taken, next) = actor.step();
        let action = encoding.encode_step(&taken).with_context(failed)?;
        clipped += action.clipped;
        values += skip * encoding.space().len();
        let next = next.map(|next| encoding.encode_step(&next)).transpose()?;
        let next = next.map(|next| row(next.values)).transpose()?;
        let given = Given {
            own_action: next.as_ref(),
            ..Given::default()
        };
        let predicted = rollout.next_given(&row(action.values)?, given)?;
        if is_seen {
            pictures.extend(subject.decode(&predicted)?);
        }
        latents.push(predicted);
    }
    Ok(Episode {
        latents: Tensor::cat(&latents, 0)?,
        pictures,
        clipped,
        values,
    })
}

fn row(values: Vec<f32>) -> Result<Tensor> {
    let shape = (1, values.len());
    Ok(Tensor::from_vec(values, shape, &Device::Cpu)?)
}

/// A policy with its remaining actions.
struct Actor<'a> {
    policy: &'a Policy,
    space: &'a ActionSpace,
    /// Actions per model step.
    skip: usize,
    /// Whole model steps of actions.
    queue: VecDeque<Vec<f32>>,
    /// The last action.
    last: Vec<f32>,
}

impl<'a> Actor<'a> {
    fn new(policy: &'a Policy, encoding: &'a ActionEncoding, start: &Start) -> Self {
        let mut actor = Self {
            policy,
            space: encoding.space(),
            skip: encoding.frame_skip(),
            queue: VecDeque::new(),
            last: start.last.clone(),
        };
        if matches!(policy, Policy::Recorded) {
            actor.queue.extend(start.recorded.iter().cloned());
            let end = still(start.recorded.last().unwrap_or(&start.last), actor.space);
            actor.fill(&end);
        }
        actor
    }

    /// Fills the last model step with `action`.
    fn fill(&mut self, action: &[f32]) {
        let whole = self.queue.len().next_multiple_of(self.skip);
        self.queue.resize(whole, action.to_vec());
    }

    /// Whether it needs new actions.
    fn needs_actions(&self) -> bool {
        self.queue.is_empty() && matches!(self.policy, Policy::Command(_))
    }

    fn request(&mut self, request: &Request<'_>) -> Result<()> {
        let Policy::Command(process) = self.policy else {
            return Ok(());
        };
        let line = process.ask(request)?;
        let answered = actions(&line, self.space)?;
        let held = answered.last().cloned();
        self.queue.extend(answered);
        if let Some(held) = held {
            self.fill(&held);
        }
        Ok(())
    }

    /// Actions of this model step, and of the next one if known.
    fn step(&mut self) -> (Vec<Vec<f32>>, Option<Vec<Vec<f32>>>) {
        let count = self.skip.min(self.queue.len());
        let mut taken: Vec<Vec<f32>> = self.queue.drain(..count).collect();
        if let Some(last) = taken.last() {
            self.last.clone_from(last);
        }
        let rest = still(&self.last, self.space);
        taken.resize(self.skip, rest.clone());
        let next: Vec<Vec<f32>> = self.queue.iter().take(self.skip).cloned().collect();
        let next = match self.policy {
            _ if !next.is_empty() => Some(next),
            Policy::Command(_) => None,
            Policy::Recorded | Policy::Still => Some(vec![rest; self.skip]),
        };
        (taken, next)
    }
}

/// No motion after an action: changes and velocities are zero, states stay.
pub(super) fn still(last: &[f32], space: &ActionSpace) -> Vec<f32> {
    let values = space.dimensions().iter().zip(last);
    values
        .map(|(dimension, last)| {
            if dimension.kind.is_motion() {
                0.0
            } else {
                *last
            }
        })
        .collect()
}
