use anyhow::Result;
use candle_core::Tensor;
use wm_zoo::{
    Loader, WebDino, WebDinoConfig,
    idm::{IdmNetwork, IdmNetworkConfig},
};

/// What names of the head's tensors begin with.
pub(super) const HEAD: &str = "idm.";

/// The encoder, and the inverse dynamics model that is trained on its features.
pub(super) struct Network {
    encoder: WebDino,
    pub(super) head: IdmNetwork,
}

impl Network {
    pub(super) fn load(
        encoder: &WebDinoConfig,
        head: &IdmNetworkConfig,
        loader: &Loader<'_>,
    ) -> Result<Self> {
        Ok(Self {
            encoder: WebDino::load(encoder, loader)?,
            head: load_head(head, loader)?,
        })
    }

    /// Pictures (B, n, H, W, 3) in 0..1 to features (B, n, h, w, C).
    pub(super) fn features(&self, pictures: &Tensor) -> Result<Tensor> {
        each_frame(pictures, |pictures| Ok(self.encoder.encode(pictures)?))
    }
}

pub(super) fn load_head(head: &IdmNetworkConfig, loader: &Loader<'_>) -> Result<IdmNetwork> {
    Ok(IdmNetwork::load(
        head,
        &loader.at(HEAD.trim_end_matches('.')),
    )?)
}

/// What `encode` makes of pictures (N, H, W, 3), for clips (B, n, H, W, 3) of them: (B, n, h, w, C).
pub(super) fn each_frame(
    clips: &Tensor,
    encode: impl Fn(&Tensor) -> Result<Tensor>,
) -> Result<Tensor> {
    let (b, n) = (clips.dim(0)?, clips.dim(1)?);
    let features = encode(&clips.flatten(0, 1)?)?;
    let (_, h, w, c) = features.dims4()?;
    Ok(features.reshape((b, n, h, w, c))?)
}
