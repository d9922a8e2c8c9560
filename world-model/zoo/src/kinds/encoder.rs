//! What every encoder provides. The rest of the crate uses encoders through [`EncoderConfig`] alone.

use std::fmt::Debug;
use std::sync::Arc;

use candle_core::Tensor;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::parse::parse;
use crate::cost::count::Cost;
use crate::sizes::check_multiple;
use crate::{Error, Loader, Result};

/// A loaded network: a batch of pictures or latents to its output.
pub(crate) type Apply = Box<dyn Fn(&Tensor) -> Result<Tensor> + Send + Sync>;

/// The configuration of an encoder. It is read from JSON, and the line of its kind in the list of kinds names it.
pub(crate) trait EncoderConfig: Canonical + Debug + Send + Sync {
    /// Checks the configuration and loads the network: (N, height, width, 3) in 0..1 to (N, rows, columns, channels).
    fn load(&self, loader: &Loader<'_>) -> Result<Apply>;

    /// Rows, columns and channels of the output for a picture of `image` (height, width). Called after
    /// [`load`](Self::load).
    fn features(&self, image: [usize; 2]) -> Result<[usize; 3]>;

    /// Parameters, and operations for a frame of 256x256, by [`count`](crate::cost::count::count) and
    /// [`applied`](crate::cost::count::applied).
    fn cost(&self) -> Result<Cost>;
}

/// What the hashes of latent spaces cover.
pub(crate) trait Canonical {
    /// Every value, defaults included, as text in the order of the fields.
    fn canonical(&self) -> Result<String>;
}

impl<C: Serialize> Canonical for C {
    fn canonical(&self) -> Result<String> {
        serde_json::to_string(self).map_err(|error| Error::ConfigFile {
            file: "the configuration".to_owned(),
            reason: error.to_string(),
        })
    }
}

/// Parses the configuration of an encoder.
pub(super) type EncoderParser = fn(&str) -> Result<Arc<dyn EncoderConfig>>;

pub(super) fn parser<C: EncoderConfig + DeserializeOwned + 'static>(
    config: &str,
) -> Result<Arc<dyn EncoderConfig>> {
    Ok(Arc::new(parse::<C>(config)?))
}

/// A network as a function.
pub(crate) fn apply<M: Send + Sync + 'static>(
    model: M,
    run: fn(&M, &Tensor) -> Result<Tensor>,
) -> Apply {
    Box::new(move |input| run(&model, input))
}

/// The [features](EncoderConfig::features) of an encoder whose output has a place for every `step`x`step` pixels.
pub(crate) fn downsampled(
    [height, width]: [usize; 2],
    step: usize,
    channels: usize,
) -> Result<[usize; 3]> {
    check_multiple(("image height", height), ("downsampling", step))?;
    check_multiple(("image width", width), ("downsampling", step))?;
    Ok([height / step, width / step, channels])
}
