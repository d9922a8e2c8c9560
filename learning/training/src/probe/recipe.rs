use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use wm_model::LatentSpace;
use wm_zoo::{
    pooled_probe::{LinearProbeConfig, TemporalProbeConfig},
    success_probe::{GroundedProbeConfig, ProbeNetworkConfig, SuccessProbeConfig},
};

use super::episodes::Negatives;
use crate::recipe::recipe;

recipe! {
    /// Settings of probe training, explained in `recipes/*/probe.yaml`.
    #[expect(missing_docs, reason = "explained in the recipes")]
    pub struct ProbeRecipe in ["tiny", "paper"] of "probe" {
        pub successes: f64,
        pub mismatches: f64,
        pub others: usize,
        pub negatives: Negatives,
        pub pointing: f64,
        pub dropout: f64,
        pub latent_noise: f64,
        pub shift: usize,
        pub model: ProbeModelRecipe,
    }
}

/// The network of a success probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ProbeKind {
    /// The paper's transformer.
    Transformer,
    /// A small network that attends to the things in an instruction.
    Grounded,
    /// A linear layer on pooled latents, without instructions.
    Linear,
    /// A transformer block over pooled frames, without instructions.
    Temporal,
}

/// Shape of the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "explained in the recipes")]
pub struct ProbeModelRecipe {
    pub kind: ProbeKind,
    pub text_features: usize,
    pub hidden: usize,
    pub frames: usize,
    pub width: usize,
    pub channels: usize,
    pub queries: usize,
    pub text_width: usize,
    pub text_depth: usize,
    pub text_heads: usize,
    pub pool: usize,
    pub depth: usize,
    pub heads: usize,
    pub ffn: usize,
    pub frame_skip: usize,
    pub max_frames: Option<usize>,
}

impl ProbeRecipe {
    pub(super) fn validate(&self) -> Result<()> {
        crate::recipe::check_batch(self.batch, self.micro_batch)?;
        for (name, share) in [
            ("successes", self.successes),
            ("mismatches", self.mismatches),
        ] {
            ensure!(
                (0.0..=1.0).contains(&share),
                "{name} is {share}, expected 0 to 1"
            );
        }
        ensure!(
            self.others > 0 || self.mismatches == 0.0,
            "others is 0, but a share of {} is to be under other instructions",
            self.mismatches
        );
        ensure!(
            self.pointing.is_finite() && self.pointing >= 0.0,
            "pointing is {}, expected 0 or more",
            self.pointing
        );
        ensure!(
            (0.0..1.0).contains(&self.dropout),
            "dropout is {}, expected 0 up to 1",
            self.dropout
        );
        ensure!(
            self.model.frame_skip > 0,
            "model.frame_skip is 0, expected at least 1"
        );
        Ok(())
    }

    /// The probe for latents of `space`, and episodes of up to `frames` frames.
    pub(super) fn config(&self, space: &LatentSpace, frames: usize) -> ProbeNetworkConfig {
        let own = &self.model;
        let (rows, columns, features) = space.shape();
        let max_frames = own.max_frames.unwrap_or(frames);
        match own.kind {
            ProbeKind::Transformer => ProbeNetworkConfig::Transformer(SuccessProbeConfig {
                features,
                max_frames,
                text_features: own.text_features,
                pool: own.pool,
                hidden: own.hidden,
                depth: own.depth,
                heads: own.heads,
                ffn: own.ffn,
                affine_norms: false,
            }),
            ProbeKind::Grounded => ProbeNetworkConfig::Grounded(GroundedProbeConfig {
                features,
                grid: [rows, columns],
                max_frames,
                text_features: own.text_features,
                frames: own.frames,
                width: own.width,
                channels: own.channels,
                queries: own.queries,
                text_width: own.text_width,
                text_depth: own.text_depth,
                text_heads: own.text_heads,
                hidden: own.hidden,
            }),
            ProbeKind::Linear => ProbeNetworkConfig::Linear(LinearProbeConfig {
                features,
                pool: own.pool,
                max_frames,
            }),
            ProbeKind::Temporal => ProbeNetworkConfig::Temporal(TemporalProbeConfig {
                features,
                max_frames,
                pool: own.pool,
                hidden: own.hidden,
                heads: own.heads,
                mlp: own.ffn,
            }),
        }
    }
}

/// Kind and sizes of `old`, for latents of `space` and episodes of up to `max_frames` frames.
pub(super) fn resized(
    old: ProbeNetworkConfig,
    space: &LatentSpace,
    max_frames: usize,
) -> ProbeNetworkConfig {
    use ProbeNetworkConfig::{Grounded, Linear, Temporal, Transformer};
    let (rows, columns, features) = space.shape();
    match old {
        Transformer(old) => Transformer(SuccessProbeConfig {
            features,
            max_frames,
            ..old
        }),
        Grounded(old) => Grounded(GroundedProbeConfig {
            features,
            grid: [rows, columns],
            max_frames,
            ..old
        }),
        Linear(old) => Linear(LinearProbeConfig {
            features,
            max_frames,
            ..old
        }),
        Temporal(old) => Temporal(TemporalProbeConfig {
            features,
            max_frames,
            ..old
        }),
    }
}
