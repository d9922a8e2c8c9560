use anyhow::Result;
use candle_core::Tensor;

/// Random numbers of a loss, for B clips of n frames, H of them history.
pub(super) struct Draws {
    /// Noise level s of each clean frame: (B, n - 1) under teacher forcing, (B, H) under diffusion forcing.
    pub(super) history_levels: Tensor,
    /// Noise added to these frames at that level.
    pub(super) history_noise: Tensor,
    /// (B, n - H, h, w, C), for the learned frames.
    pub(super) noise: Tensor,
    /// (B, n - H).
    pub(super) tau: Tensor,
}

impl Draws {
    /// Frames as history, each with a little noise at its own level.
    pub(super) fn as_history(&self, clean: &Tensor) -> Result<Tensor> {
        let (b, n) = self.history_levels.dims2()?;
        let levels = self.history_levels.reshape((b, n, 1, 1, 1))?;
        let noised = (clean + self.history_noise.broadcast_mul(&levels)?)?;
        Ok(noised.broadcast_div(&(levels.sqr()? + 1.0)?.sqrt()?)?)
    }
}
