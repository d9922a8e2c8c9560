//! `wm model rollout`.

use super::running::RunningArgs;
use anyhow::{Context as _, Result, ensure};
use clap::Args;
use wm_model::sampler::Sampler;
use wm_zoo::kinds::{self, DitConfig, Kind, RolloutOptions};

/// Inputs and outputs.
const TENSORS: &str =
    "Input: context (B,T,H,W,C), T observed latents (2 in the paper); actions (B,T+K,A), where \
                       action i is paired with frame i
and leads from it to the next frame; noise (B,K,H,W,C). Output: \
                       predicted (B,K,H,W,C). The configuration is that of
`wm model forward --kind dit`.";

/// Predicts frames.
#[derive(Args, Debug)]
#[command(after_help = TENSORS)]
pub(crate) struct RolloutCommand {
    /// Kind of the model; only one kind predicts frames
    #[arg(long, default_value_t = Kind::Dit)]
    kind: Kind,
    #[command(flatten)]
    running: RunningArgs,
    /// Euler steps per frame
    #[arg(long, default_value_t = Sampler::default().steps)]
    steps: usize,
    /// Time shift gamma; 1 means no shift [default: as in the training of models with such latents]
    #[arg(long)]
    shift: Option<f64>,
    /// Noise level tau of the context frames
    #[arg(long, default_value_t = Sampler::default().context_tau)]
    context_tau: f64,
    /// Compute the whole window in every Euler step, as the reference does, instead of reusing the keys and values of
    /// clean frames
    #[arg(long)]
    no_cache: bool,
}

impl RolloutCommand {
    pub(crate) fn run(self) -> Result<()> {
        ensure!(
            self.kind == Kind::Dit,
            "kind {} predicts no frames; expected dit",
            self.kind
        );
        let files = self.running.read(self.kind)?;
        let config: DitConfig = serde_json::from_str(&files.config).context("the configuration")?;
        let published = config.transition()?.sampler.shift;
        let options = RolloutOptions {
            sampler: Sampler {
                steps: self.steps,
                shift: self.shift.unwrap_or(published),
                context_tau: self.context_tau,
            },
            cache: !self.no_cache,
        };
        let outputs = kinds::rollout(
            &files.config,
            &files.checkpoint,
            &files.inputs,
            &options,
            &files.compute,
        )
        .context("rollout")?;
        self.running.write(outputs)
    }
}
