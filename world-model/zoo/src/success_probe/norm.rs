//! The probe's normalisation.

use candle_core::Tensor;

use super::SuccessProbeConfig;
use crate::Result;
use crate::layers::rms_norm;
use crate::loader::Loader;

/// Epsilon of the norms of tokens.
const EPS: f64 = 1e-6;

/// RMSNorm over the last dimension.
#[derive(Clone, Debug)]
pub(super) struct RmsNorm {
    eps: f64,
    weight: Option<Tensor>,
}

impl RmsNorm {
    /// `name.weight` (width) is there if the configuration's norms are affine.
    pub(super) fn load(
        config: &SuccessProbeConfig,
        loader: &Loader<'_>,
        name: &str,
        width: usize,
    ) -> Result<Self> {
        let weight = || loader.tensor(&format!("{name}.weight"), &[width]);
        let weight = config.affine_norms.then(weight).transpose()?;
        Ok(Self { eps: EPS, weight })
    }

    /// The same for queries and keys, where epsilon only guards against division by zero.
    pub(super) fn for_heads(self) -> Self {
        Self {
            eps: f64::from(f32::EPSILON),
            ..self
        }
    }

    pub(super) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let normed = rms_norm(x, self.eps)?;
        Ok(match &self.weight {
            Some(weight) => normed.broadcast_mul(weight)?,
            None => normed,
        })
    }
}
