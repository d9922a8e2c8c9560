//! The cost of the transition model.

use wm_model::transition::TransitionConfig;

use super::{ACTIONS, Cost, applied, attended, count};
use crate::Result;
use crate::kinds::dit::{DitConfig, Head, build as build_dit};
use crate::loader::Requested;

/// Frames of the clip over which operations are averaged.
pub const CLIP_FRAMES: usize = 10;

/// Counts a transition model; operations are those of a frame of a clip of [`CLIP_FRAMES`].
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn transition(config: &DitConfig) -> Result<Cost> {
    let sizes = config.transition()?;
    count(
        |loader| build_dit(config, loader),
        |weight| operations(weight, &sizes),
    )
}

/// Counts a transition model that was trained here; operations as of `transition`.
///
/// # Errors
/// If the configuration cannot be built.
pub fn transition_of(config: &TransitionConfig) -> Result<Cost> {
    transition(&DitConfig::of(config))
}

/// DiT-L on latents (height, width, channels).
pub(super) fn large(latent: (usize, usize, usize), patch: usize, wide: bool) -> Result<Cost> {
    let preset = TransitionConfig::preset("dit-l", latent, patch, ACTIONS)?;
    transition(&DitConfig {
        head: if wide { Head::Wide } else { Head::Plain },
        ..DitConfig::of(&preset)
    })
}

/// Operations for one frame: its tokens go through most layers, its conditioning once through modulation and time
/// embedding. By convention patch and action embedding do not count.
fn operations(weight: &Requested, sizes: &TransitionConfig) -> usize {
    let tokens = sizes.tokens();
    let name = weight.name.as_str();
    if name.starts_with("x_proj") || name.starts_with("action_embedder") {
        return 0;
    }
    let is_once_a_frame = name.starts_with("timestep_mlp") || name.contains("adaLN_modulation");
    let products = applied(weight, if is_once_a_frame { 1 } else { tokens });
    let attention = if name.ends_with("s_block.attn.qkv_proj.weight") {
        attended(tokens, tokens, sizes.hidden)
    } else if name.ends_with("t_block.attn.qkv_proj.weight") {
        // Causal, but counted as if every frame saw the whole clip.
        attended(tokens, CLIP_FRAMES, sizes.hidden)
    } else {
        0
    };
    products + attention
}
