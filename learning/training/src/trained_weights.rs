//! Weights files of trainings.

use anyhow::Result;
use serde::Serialize;
use wm_model::{
    LatentSpace,
    transition::{ACTIONS_KEY, LATENT_SPACE_KEY},
    weights::{Precision, WeightsBuilder},
};
use wm_motion::actions::ActionEncoding;

use crate::optimiser::ParameterValues;

/// Weights are saved as half floats.
pub(crate) const PRECISION: Precision = Precision::F16;

/// A file with these tensors of a network with its configuration under `key`, and its latent `space`, if it reads latents.
pub(crate) fn trained_weights(
    tensors: &mut dyn Iterator<Item = ParameterValues<'_>>,
    (key, config): (&str, &impl Serialize),
    space: Option<&LatentSpace>,
) -> Result<WeightsBuilder> {
    let mut weights = WeightsBuilder::new();
    for ParameterValues {
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

/// [`trained_weights`] of a network for actions.
pub(crate) fn trained_weights_of_actions(
    tensors: &mut dyn Iterator<Item = ParameterValues<'_>>,
    config: (&str, &impl Serialize),
    space: &LatentSpace,
    actions: &ActionEncoding,
) -> Result<WeightsBuilder> {
    let mut weights = trained_weights(tensors, config, Some(space))?;
    weights.metadata(ACTIONS_KEY, serde_json::to_string(actions)?);
    Ok(weights)
}
