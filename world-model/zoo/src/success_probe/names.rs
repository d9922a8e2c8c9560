//! Key names of the success probe's tensors.

use crate::loader::Loader;

/// Whose names a checkpoint uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Names {
    /// The authors' release.
    Published,
    /// Checkpoints of our own.
    Short,
}

impl Names {
    /// The names that the checkpoint of `loader` uses.
    pub(super) fn of(loader: &Loader<'_>) -> Self {
        // Of a checkpoint: what is trained here has short names, and no CLS token, which would get no gradient.
        match loader.shape("blocks.0.spatial_attn.q_proj.weight") {
            Some(_) => Self::Published,
            None => Self::Short,
        }
    }

    /// Query, key, value and output of an attention.
    pub(super) fn attention(self) -> [&'static str; 4] {
        match self {
            Self::Published => ["q_proj", "k_proj", "v_proj", "out_proj"],
            Self::Short => ["q", "k", "v", "out"],
        }
    }

    /// Shape of the temporal embedding, of `frames`.
    pub(super) fn temporal(self, frames: usize, width: usize) -> Vec<usize> {
        match self {
            Self::Published => vec![1, frames, 1, width],
            Self::Short => vec![frames, width],
        }
    }

    /// Shape of the spatial embedding, of `places` in a frame.
    pub(super) fn spatial(self, places: usize, width: usize) -> Vec<usize> {
        match self {
            Self::Published => vec![1, 1, places, width],
            Self::Short => vec![places, width],
        }
    }
}
