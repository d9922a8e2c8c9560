//! What the tensors of the same network are called in different checkpoints.

/// Whose key names a checkpoint uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Naming {
    /// diffusers' `AutoencoderKL`.
    Diffusers,
    /// The latent-diffusion code base, which VA-VAE and Cosmos descend from.
    LatentDiffusion,
    /// The pixel decoder of the paper.
    Pixel,
}

/// Names of the parts of an attention block.
pub(super) struct AttentionNames {
    pub(super) norm: &'static str,
    pub(super) query: &'static str,
    pub(super) key: &'static str,
    pub(super) value: &'static str,
    pub(super) out: &'static str,
    /// Whether the projections are stored as 1x1 convolutions (out, in, 1, 1) and not as (out, in).
    pub(super) convolutions: bool,
}

impl Naming {
    /// The 1x1 convolution around a residual block that changes the channels.
    pub(super) fn shortcut(self) -> &'static str {
        match self {
            Self::Diffusers => "conv_shortcut",
            Self::LatentDiffusion => "nin_shortcut",
            Self::Pixel => "skip",
        }
    }

    pub(super) fn attention(self) -> AttentionNames {
        match self {
            Self::Diffusers => AttentionNames {
                norm: "group_norm",
                query: "to_q",
                key: "to_k",
                value: "to_v",
                out: "to_out.0",
                convolutions: false,
            },
            Self::LatentDiffusion | Self::Pixel => AttentionNames {
                norm: "norm",
                query: "q",
                key: "k",
                value: "v",
                out: "proj_out",
                convolutions: true,
            },
        }
    }

    /// The residual block, the attention and the second residual block of the middle.
    pub(super) fn middle(self) -> [&'static str; 3] {
        match self {
            Self::Diffusers => [
                "mid_block.resnets.0",
                "mid_block.attentions.0",
                "mid_block.resnets.1",
            ],
            Self::LatentDiffusion => ["mid.block_1", "mid.attn_1", "mid.block_2"],
            Self::Pixel => ["mid_block1", "mid_attn", "mid_block2"],
        }
    }

    /// Level `level` of an encoder; 0 is the finest and runs first.
    pub(super) fn down(self, level: usize) -> String {
        match self {
            Self::Diffusers => format!("down_blocks.{level}"),
            Self::LatentDiffusion | Self::Pixel => format!("down.{level}"),
        }
    }

    /// Level `level` of a decoder of `levels`; 0 is the finest and runs last.
    pub(super) fn up(self, level: usize, levels: usize) -> String {
        // diffusers and the pixel decoder count in running order, from the coarsest.
        let order = levels.saturating_sub(level + 1);
        match self {
            Self::Diffusers => format!("up_blocks.{order}"),
            Self::LatentDiffusion => format!("up.{level}"),
            Self::Pixel => format!("up_levels.{order}"),
        }
    }

    /// Residual block `index` of a level.
    pub(super) fn block(self, index: usize) -> String {
        match self {
            Self::Diffusers => format!("resnets.{index}"),
            Self::LatentDiffusion => format!("block.{index}"),
            Self::Pixel => format!("blocks.{index}"),
        }
    }

    /// Attention after residual block `index` of a level.
    pub(super) fn block_attention(self, index: usize) -> String {
        match self {
            Self::Diffusers => format!("attentions.{index}"),
            Self::LatentDiffusion => format!("attn.{index}"),
            // One for the level, after its last block.
            Self::Pixel => "attn".to_owned(),
        }
    }

    /// The convolution that halves the size at the end of a level.
    pub(super) fn downsample(self) -> &'static str {
        match self {
            Self::Diffusers => "downsamplers.0.conv",
            Self::LatentDiffusion | Self::Pixel => "downsample.conv",
        }
    }

    /// The convolution after the size was doubled at the end of a level.
    pub(super) fn upsample(self) -> &'static str {
        match self {
            Self::Diffusers => "upsamplers.0.conv",
            Self::LatentDiffusion | Self::Pixel => "upsample.conv",
        }
    }

    /// The first convolution.
    pub(super) fn conv_in(self) -> &'static str {
        match self {
            Self::Diffusers | Self::LatentDiffusion => "conv_in",
            Self::Pixel => "proj_in",
        }
    }

    /// The normalisation before the last convolution, which is `conv_out` everywhere.
    pub(super) fn norm_out(self) -> &'static str {
        match self {
            Self::Diffusers => "conv_norm_out",
            Self::LatentDiffusion | Self::Pixel => "norm_out",
        }
    }
}
