//! The transition model from its published checkpoints.

use serde::{Deserialize, Serialize};
use wm_model::ops::RopeLayout;
use wm_model::sampler::Sampler;
use wm_model::transition::{
    ActionAlignment, LoadedTransition, PackedTransition, Parametrisation, Transition,
    TransitionConfig, published_shift,
};
use wm_model::{Compute, Kernels};

use super::kind::Kind;
use crate::checkpoint::Average;
use crate::{Checkpoint, Loader, Result};

/// Width of the wide head of all published models that have one (the paper, appendix B, table
/// "Architecture size and compute").
const WIDE: usize = 2048;

/// Which last layers a transition model has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Head {
    /// Modulation and one product.
    #[default]
    Plain,
    /// A wider layer before it, for native latents of many channels.
    Wide,
}

/// Sizes of a transition model (`docs/architecture.md#transition-model`). JSON example, DiT-L on V-JEPA 2.1's native latents:
///
/// ```json
/// {"hidden": 1024, "depth": 24, "heads": 16, "channels": 1024, "patch": 1, "grid": [16, 16],
///  "action_dim": 10, "max_frames": 10, "head": "wide", "wide_dim": 2048}
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DitConfig {
    /// Width of a token.
    pub hidden: usize,
    /// Blocks, each of a spatial and a temporal sub-block.
    pub depth: usize,
    /// Attention heads.
    pub heads: usize,
    /// Channels of a latent.
    pub channels: usize,
    /// Side of a patch in latent places.
    pub patch: usize,
    /// Rows and columns of a latent, before patching.
    pub grid: [usize; 2],
    /// Camera views that lie side by side in a latent, 1 if absent; with several, positions have three axes (row,
    /// column in the view, view).
    #[serde(default = "one_view")]
    pub views: usize,
    /// Positions of several views: `reference` (the default, and every published checkpoint's) or `by_view`.
    #[serde(default)]
    pub rope_layout: RopeLayout,
    /// Values of an action.
    pub action_dim: usize,
    /// Frames that the model sees at most, the new one included.
    #[serde(default = "default_max_frames")]
    pub max_frames: usize,
    /// The last layers.
    #[serde(default)]
    pub head: Head,
    /// Width of the wide head, 2048 if absent; without meaning for the plain one.
    #[serde(default)]
    pub wide_dim: Option<usize>,
}

fn one_view() -> usize {
    1
}

fn default_max_frames() -> usize {
    10
}

impl DitConfig {
    /// The sizes of a model of ours.
    pub(crate) fn of(config: &TransitionConfig) -> Self {
        Self {
            hidden: config.hidden,
            depth: config.depth,
            heads: config.heads,
            channels: config.channels,
            patch: config.patch,
            grid: [config.latent_height, config.latent_width],
            views: config.views,
            rope_layout: config.rope_layout,
            action_dim: config.action_dim,
            max_frames: config.max_frames,
            head: match config.wide_head {
                None => Head::Plain,
                Some(_) => Head::Wide,
            },
            wide_dim: config.wide_head,
        }
    }

    /// The configuration of [`Transition`], with the conventions of the published checkpoints.
    ///
    /// # Errors
    /// If a model of these sizes cannot be built.
    pub fn transition(&self) -> Result<TransitionConfig> {
        let [latent_height, latent_width] = self.grid;
        let config = TransitionConfig {
            hidden: self.hidden,
            depth: self.depth,
            heads: self.heads,
            patch: self.patch,
            latent_height,
            latent_width,
            views: self.views,
            rope_layout: self.rope_layout,
            channels: self.channels,
            action_dim: self.action_dim,
            max_frames: self.max_frames,
            wide_head: match self.head {
                Head::Plain => None,
                Head::Wide => Some(self.wide_dim.unwrap_or(WIDE)),
            },
            parametrisation: Parametrisation::Velocity,
            action_alignment: ActionAlignment::WithFrame,
            frame_skip: 2,
            sampler: Sampler {
                shift: published_shift(self.patch, self.channels),
                ..Sampler::default()
            },
        };
        config.validate()?;
        Ok(config)
    }

    /// The model with the weights of `checkpoint` (the averaged ones, if it has both), ready for inference on the
    /// device, in the number format and with the kernels of `compute`: what [`Rollout`](wm_model::sampler::Rollout) and the planner run on.
    ///
    /// # Errors
    /// If a model of these sizes cannot be built, the checkpoint's tensors are not the model's, or the device cannot be
    /// used or has no memory for it.
    pub fn load(&self, checkpoint: &Checkpoint, compute: &Compute) -> Result<LoadedTransition> {
        let checkpoint = Kind::Dit.weights(checkpoint, Average::Ema);
        let loader = Loader::new(&checkpoint, compute)?;
        let model = load_transition(self.transition()?, &loader, compute)?;
        loader.finish()?;
        Ok(model)
    }
}

/// Builds the model from the tensors of `loader`.
pub(crate) fn build(config: &DitConfig, loader: &Loader<'_>) -> Result<Transition> {
    build_transition(config.transition()?, loader)
}

/// The model of the tensors of `loader`, ready to compute. The CPU's kernels have the weights packed from where they lie.
pub(crate) fn load_transition(
    config: TransitionConfig,
    loader: &Loader<'_>,
    compute: &Compute,
) -> Result<LoadedTransition> {
    Ok(match compute.kernels() {
        Kernels::Cpu => PackedTransition::build(config, loader)?.into(),
        Kernels::Candle => compute.load(build_transition(config, loader)?, loader.format())?,
    })
}

/// As [`build`], with conventions of one's own.
pub(crate) fn build_transition(
    config: TransitionConfig,
    loader: &Loader<'_>,
) -> Result<Transition> {
    Ok(Transition::build(config, &mut |parameter| {
        Ok(loader.tensor(&parameter.name, &parameter.shape)?)
    })?)
}
