//! Runs one imagined episode: the policy acts, the world model predicts.

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use image::RgbImage;
use wm_model::{
    Decoder, WorldModel,
    sampler::{Given, Rollout, Sampler},
};

use super::{
    actor::Actor,
    protocol::{ActionSpaceInfo, Request, VERSION},
    setup::Policy,
};
use crate::{picture_strip::png, subject::decode};

/// The model that an episode is imagined with.
#[derive(Clone, Copy)]
pub(crate) struct Imagination<'a> {
    pub world: &'a WorldModel,
    pub sampler: &'a Sampler,
    /// Programs need it, to see.
    pub decoder: Option<&'a dyn Decoder>,
    /// Cameras, side by side in a picture.
    pub views: usize,
}

/// Start of an episode.
#[derive(Clone, Debug)]
pub(crate) struct Start {
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
pub(crate) struct Trial<'a> {
    pub task: &'a str,
    pub trial: usize,
    pub seed: u64,
    pub instruction: &'a str,
}

/// An imagined episode.
#[derive(Clone, Debug)]
pub(crate) struct Episode {
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
pub(crate) fn imagine(
    model: Imagination<'_>,
    policy: &Policy,
    start: &Start,
    trial: Trial<'_>,
    (steps, is_seen): (usize, bool),
) -> Result<Episode> {
    let encoding = &model.world.encoding;
    let skip = encoding.frame_skip();
    let space = ActionSpaceInfo::of(encoding);
    let mut actor = Actor::new(policy, encoding, &start.last, &start.recorded);
    let is_seen = is_seen || matches!(policy, Policy::Command(_));
    let mut rollout = Rollout::new(
        &model.world.transition,
        model.sampler,
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
                views: model.views,
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
            let decoder = model.decoder.context("the model has no decoder")?;
            pictures.extend(decode(decoder, &predicted)?);
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
