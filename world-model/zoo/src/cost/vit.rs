//! The cost of the vision transformers, without attention products (see [`super`] for the conventions).

use super::{Cost, applied, count};
use crate::Result;
use crate::loader::Requested;
use crate::vit::{SiglipVision, SiglipVisionConfig, Vjepa, VjepaConfig, WebDino, WebDinoConfig};

/// Counts V-JEPA 2.1.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn vjepa(config: &VjepaConfig) -> Result<Cost> {
    let tokens = config.grid() * config.grid();
    count(
        |loader| Vjepa::load(config, loader),
        |weight| match weight.name.starts_with("blocks.") {
            true => applied(weight, tokens),
            false => 0,
        },
    )
}

/// Counts Web-DINO.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn web_dino(config: &WebDinoConfig) -> Result<Cost> {
    let patches = config.grid() * config.grid();
    count(
        |loader| WebDino::load(config, loader),
        |weight| {
            if weight.name.starts_with("encoder.layer.") {
                // And CLS.
                applied(weight, patches + 1)
            } else if weight.name.contains("patch_embeddings") {
                applied(weight, patches)
            } else {
                0
            }
        },
    )
}

/// Counts the vision tower of SigLIP 2.
///
/// # Errors
/// If the configuration cannot be built.
pub(crate) fn siglip2(config: &SiglipVisionConfig) -> Result<Cost> {
    let tokens = config.grid() * config.grid();
    count(
        |loader| SiglipVision::load(config, loader),
        |weight| {
            if weight.name.contains("encoder.layers.") {
                applied(weight, tokens)
            } else if weight.name.contains("head.") {
                pooling(weight, tokens)
            } else {
                0
            }
        },
    )
}

/// The pooling head: one learned query over all tokens.
fn pooling(weight: &Requested, tokens: usize) -> usize {
    if weight.name.ends_with("probe") {
        return 0;
    }
    if weight.name.ends_with("in_proj_weight") {
        // A third of it each for the query, the keys and the values.
        return applied(weight, 1 + 2 * tokens) / 3;
    }
    applied(weight, 1)
}
