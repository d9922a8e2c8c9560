//! `wm model forward`.

use super::running::RunningArgs;
use anyhow::{Context as _, Result};
use clap::Args;
use wm_zoo::kinds::{self, Kind};

/// Inputs and outputs of each kind; the same table as in `wm_zoo::kinds`.
const KINDS: &str = "\
Kinds, their configurations and tensors (image: N,256,256,3 in 0..1; latent: N,h,w,D):
  dit                      {hidden, depth, heads, channels, patch, grid [h,w] before patching, action_dim, max_frames,
                           head \"plain\"|\"wide\", wide_dim, [views, rope_layout \"reference\"|\"by_view\"]}; x (B,T,H,W,C), tau (B,T) in 0..1, action (B,T,A)
                           -> velocity (B,T,H,W,C)
  web-dino                 Hugging Face config.json (Dinov2); image -> latent
  siglip2                  Hugging Face config.json (Siglip); image -> latent
  siglip2-text             Hugging Face config.json (Siglip); input_ids (B,L), [text_mask (B,L)] -> features (B,L,D)
  vjepa2.1                 {hidden, depth, heads, patch, [image_size, mlp, tubelet, output_norms]}; image -> latent
  sd3-vae[-decoder]        diffusers config.json (AutoencoderKL), [apply_scaling]; image -> latent, latent -> image
  va-vae[-decoder]         {channels, multipliers, res_blocks, latent, resolution, attention_resolutions, [groups]};
                           image -> latent, latent -> image
  cosmos-ci16x16[-decoder] {channels, multipliers, res_blocks, latent, patch, compression, [groups]};
                           image -> latent, latent -> image
  svae                     {features, latent, heads, layers, ffn}; features (N,h,w,D) -> latent, features;
                           latent alone -> features
  pixel                    {latent, base, multipliers, res_blocks, heads}; latent -> image
  idm                      {features, horizon, [patch, grid, hidden, depth, heads, mlp, actions]};
                           latents (B,k+1,h,w,D) -> actions (B,k,7)
  success-probe            {features, max_frames, [text_features, pool, hidden, depth, heads, ffn, affine_norms]};
                           latents (B,T,h,w,D), text (B,L,D'), [text_mask (B,L)] -> logit (B)
  linear-probe             {features, [pool, max_frames]}; latents (B,T,h,w,D) -> logit (B)
  temporal-probe           {features, [max_frames, pool, hidden, heads, mlp]}; latents (B,T,h,w,D) -> logit (B)
  progress-probe           {features, [pool, hidden, max_frames]}; latents (B,T,h,w,D) -> progress (B,T)
  efficientnet-lite0       {block 8..10}; image -> block_8 .. block_10";

/// Runs a model.
#[derive(Args, Debug)]
#[command(after_help = KINDS)]
pub(crate) struct ForwardCommand {
    /// Kind of the model
    #[arg(long)]
    kind: Kind,
    #[command(flatten)]
    running: RunningArgs,
}

impl ForwardCommand {
    pub(crate) fn run(self) -> Result<()> {
        let files = self.running.read(self.kind)?;
        let outputs = kinds::forward(
            self.kind,
            &files.config,
            &files.checkpoint,
            &files.inputs,
            &files.compute,
        )
        .with_context(|| format!("{}", self.kind))?;
        self.running.write(outputs)
    }
}
