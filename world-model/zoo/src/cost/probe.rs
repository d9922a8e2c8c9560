//! The cost of the success probe and of the text tower it reads, without attention products.

use super::{Cost, applied, count};
use crate::Result;
use crate::pooled_probe::config::PooledProbeConfig;
use crate::success_probe::{SuccessProbe, SuccessProbeConfig};
use crate::vit::{SiglipText, SiglipTextConfig};

/// Counts the text tower of SigLIP 2, for an instruction; its pooling head is not run.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn siglip2_text(config: &SiglipTextConfig) -> Result<Cost> {
    count(
        |loader| SiglipText::load(config, loader),
        |weight| match weight.name.contains("encoder.layers.") {
            true => applied(weight, config.max_position_embeddings),
            false => 0,
        },
    )
}

/// Counts a success probe, for an episode of `max_frames` and an instruction of `text_length` tokens.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn success_probe(config: &SuccessProbeConfig, text_length: usize) -> Result<Cost> {
    let tokens = config.max_frames * config.pool * config.pool;
    count(
        |loader| SuccessProbe::load(config, loader),
        |weight| {
            let name = weight.name.as_str();
            let of_text = [
                "text_proj.weight",
                "cross_attn.k.weight",
                "cross_attn.v.weight",
            ];
            if of_text.iter().any(|end| name.ends_with(end)) {
                applied(weight, text_length)
            } else if name.starts_with("blocks.") || name == "input_proj.weight" {
                applied(weight, tokens)
            } else if name == "head.weight" {
                applied(weight, 1)
            } else {
                0
            }
        },
    )
}

/// Counts a probe of pooled latents, for the longest episode.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn pooled_probe(config: &PooledProbeConfig) -> Result<Cost> {
    let frames = match config {
        // It is counted for one frame, as it reads each by itself.
        PooledProbeConfig::Linear(_) => 1,
        PooledProbeConfig::Temporal(config) => config.max_frames,
        PooledProbeConfig::Progress(config) => config.max_frames,
    };
    count(
        |loader| config.load(loader),
        |weight| match weight.shape.len() {
            2 => applied(weight, frames),
            _ => 0,
        },
    )
}
