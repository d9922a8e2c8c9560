//! Key names of the inverse dynamics model's tensors.

use crate::loader::Loader;
use crate::vit::BlockNames;

/// What a checkpoint calls the tensors.
#[derive(Debug)]
pub(super) struct Names {
    pub(super) temporal: &'static str,
    pub(super) spatial: &'static str,
    pub(super) queries: &'static str,
    pub(super) blocks: &'static str,
    pub(super) block: BlockNames,
    pub(super) norm: &'static str,
}

impl Names {
    /// The names in the authors' release.
    const PUBLISHED: Self = Self {
        temporal: "temporal_pos_emb",
        spatial: "spatial_pos_emb",
        queries: "cls_queries",
        blocks: "transformer",
        block: BlockNames {
            qkv: "attn.qkv_proj",
            out: "attn.out_proj",
            first: "mlp.0",
            second: "mlp.3",
        },
        norm: "final_norm",
    };

    /// timm's names, for checkpoints of our own.
    const TIMM: Self = Self {
        temporal: "temporal_embed",
        spatial: "spatial_embed",
        queries: "cls",
        blocks: "blocks",
        block: BlockNames::TIMM,
        norm: "norm",
    };

    /// The names that the checkpoint of `loader` uses.
    pub(super) fn of(loader: &Loader<'_>) -> &'static Self {
        match loader.has(Self::PUBLISHED.queries) {
            true => &Self::PUBLISHED,
            false => &Self::TIMM,
        }
    }
}
