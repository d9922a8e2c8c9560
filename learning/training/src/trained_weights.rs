//! The file of weights that a training leaves.

use anyhow::Result;
use serde::Serialize;
use wm_model::{
    LatentSpace,
    transition::{ACTIONS_KEY, LATENT_SPACE_KEY},
    weights::{Precision, WeightsBuilder},
};
use wm_motion::actions::ActionEncoding;

use crate::optimiser::Trained;

/// Weights are saved as half floats.
pub(crate) const PRECISION: Precision = Precision::F16;

/// A file with these tensors, of a network whose configuration belongs under `key`; of one that reads latents, with their
/// `space`.
pub(crate) fn trained_weights(
    tensors: &mut dyn Iterator<Item = Trained<'_>>,
    (key, config): (&str, &impl Serialize),
    space: Option<&LatentSpace>,
) -> Result<WeightsBuilder> {
    let mut weights = WeightsBuilder::new();
    for Trained {
        name,
        shape,
        values,
    } in tensors
    {
        weights.values(name, shape, values, PRECISION);
    }
    weights.metadata(key, serde_json::to_string(config)?);
    if let Some(space) = space {
        weights.metadata(LATENT_SPACE_KEY, serde_json::to_string(space)?);
    }
    Ok(weights)
}

/// The same for a network of actions.
pub(crate) fn trained_weights_of_actions(
    tensors: &mut dyn Iterator<Item = Trained<'_>>,
    config: (&str, &impl Serialize),
    space: &LatentSpace,
    actions: &ActionEncoding,
) -> Result<WeightsBuilder> {
    let mut weights = trained_weights(tensors, config, Some(space))?;
    weights.metadata(ACTIONS_KEY, serde_json::to_string(actions)?);
    Ok(weights)
}
