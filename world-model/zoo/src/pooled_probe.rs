//! The simpler probes: what can be read from pooled latents without an instruction.
//!
//! | kind | what | output |
//! |---|---|---|
//! | [`LinearProbe`] | one linear layer on each frame, pooled to 1x1, 4x4 or 8x8 | `logit` of success (B), the mean over frames |
//! | [`TemporalProbe`] | one transformer block over the frames, read out at a CLS token | `logit` of success (B) |
//! | [`ProgressProbe`] | a two-layer network on each frame | `progress` from 0 to 1 (B, T) |
//!
//! They stand beside the [success probe](crate::success_probe), which reads an instruction; these know one task, or tell
//! successes apart whatever the task is. All take raw latents (B, T, h, w, features), pooled by adaptive averaging to
//! `pool` x `pool`; a frame's values are in the order (row, column, channel).
//!
//! The release has probes of these kinds. The key names here are our own: it is not known what the release calls them.

pub(crate) mod config;
mod linear;
mod progress;
mod temporal;

use candle_core::{DType, Tensor};

pub use linear::{LinearProbe, LinearProbeConfig};
pub use progress::{ProgressProbe, ProgressProbeConfig};
pub use temporal::{TemporalProbe, TemporalProbeConfig};

use crate::Result;
use crate::sizes::shape_error;
use crate::vit::resample::{AxisWeights, resample};

/// Any of them.
#[derive(Clone, Debug)]
pub enum PooledProbe {
    /// A linear layer on each frame.
    Linear(LinearProbe),
    /// A transformer block over the frames.
    Temporal(Box<TemporalProbe>),
    /// How far each frame has come.
    Progress(ProgressProbe),
}

impl PooledProbe {
    /// From 0 to 1, how sure the probe is that the episode `latents` (1, T, h, w, features) is a success; of a progress
    /// probe, how far the newest frame has come.
    ///
    /// # Errors
    /// If the latents have another shape, or a value is not finite.
    pub fn probability(&self, latents: &Tensor) -> Result<f32> {
        let newest = |values: &Tensor| -> Result<Option<f32>> {
            Ok(values.flatten_all()?.to_vec1::<f32>()?.pop())
        };
        let sigmoid = |logit: f32| 1.0 / (1.0 + (-logit).exp());
        let probability = match self {
            Self::Linear(probe) => newest(&probe.forward(latents)?)?.map(sigmoid),
            Self::Temporal(probe) => newest(&probe.forward(latents)?)?.map(sigmoid),
            Self::Progress(probe) => newest(&probe.forward(latents)?)?,
        };
        probability.filter(|p| p.is_finite()).ok_or_else(|| {
            let what = "the probe's probability";
            wm_model::Error::NotFinite { what }.into()
        })
    }

    /// Longest episode that is read.
    pub fn max_frames(&self) -> usize {
        match self {
            Self::Linear(probe) => probe.config().max_frames,
            Self::Temporal(probe) => probe.config().max_frames,
            Self::Progress(probe) => probe.config().max_frames,
        }
    }
}

/// Frames of the longest episode where a configuration does not say: the success probe's.
fn default_max_frames() -> usize {
    64
}

/// Rows, and columns, that a frame is pooled to where a configuration does not say: its mean.
fn default_pool() -> usize {
    1
}

/// Latents (B, T, h, w, features) with T from 1 to `max_frames`, to (B, T, pool * pool * features), f32.
fn pooled(latents: &Tensor, features: usize, pool: usize, max_frames: usize) -> Result<Tensor> {
    let (b, t, h, w, c) = match latents.dims() {
        &[b, t, h, w, c] if c == features && (1..=max_frames).contains(&t) && h * w > 0 => {
            (b, t, h, w, c)
        }
        _ => {
            let expected = format!("(B, T, h, w, {features}) with T from 1 to {max_frames}");
            return Err(shape_error("the latents", expected, latents));
        }
    };
    let rows = AxisWeights::adaptive_average(h, pool);
    let columns = AxisWeights::adaptive_average(w, pool);
    let frames = latents.to_dtype(DType::F32)?.reshape((b * t, h, w, c))?;
    let pooled = resample(&frames, &rows, &columns)?;
    Ok(pooled.reshape((b, t, pool * pool * c))?)
}
