//! Sizes of the success probe.

use serde::{Deserialize, Serialize};

use crate::Result;
use crate::sizes::{check_counts, check_multiple, check_sizes};

/// Sizes of the success probe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessProbeConfig {
    /// Channels of the latents.
    pub features: usize,
    /// Frames of the longest episode, the length of the temporal embedding.
    pub max_frames: usize,
    /// Channels of the text's tokens.
    #[serde(default = "default_text_features")]
    pub text_features: usize,
    /// Rows, and columns, that a frame is pooled to.
    #[serde(default = "default_pool")]
    pub pool: usize,
    /// Width of the tokens.
    #[serde(default = "default_hidden")]
    pub hidden: usize,
    /// Number of blocks.
    #[serde(default = "default_depth")]
    pub depth: usize,
    /// Attention heads.
    #[serde(default = "default_heads")]
    pub heads: usize,
    /// Hidden width of the feed-forward networks.
    #[serde(default = "default_ffn")]
    pub ffn: usize,
    /// Whether every RMSNorm has a weight per channel.
    #[serde(default)]
    pub affine_norms: bool,
}

fn default_text_features() -> usize {
    1152
}

fn default_pool() -> usize {
    4
}

fn default_hidden() -> usize {
    384
}

fn default_depth() -> usize {
    6
}

fn default_heads() -> usize {
    8
}

fn default_ffn() -> usize {
    1024
}

impl SuccessProbeConfig {
    /// The paper's, for latents with this many channels and episodes of up to `max_frames`.
    pub fn paper(features: usize, max_frames: usize) -> Self {
        Self {
            features,
            max_frames,
            text_features: default_text_features(),
            pool: default_pool(),
            hidden: default_hidden(),
            depth: default_depth(),
            heads: default_heads(),
            ffn: default_ffn(),
            affine_norms: false,
        }
    }

    pub(super) fn validate(&self) -> Result<()> {
        check_sizes(&[
            ("features", self.features),
            ("max_frames", self.max_frames),
            ("text_features", self.text_features),
            ("pool", self.pool),
            ("hidden", self.hidden),
            ("heads", self.heads),
            ("ffn", self.ffn),
        ])?;
        check_counts(&[("depth", self.depth)])?;
        check_multiple(("hidden", self.hidden), ("heads", self.heads))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_may_be_short() {
        let json = r#"{"features": 1152, "max_frames": 40}"#;
        let config: SuccessProbeConfig = serde_json::from_str(json).unwrap();
        assert_eq!(config, SuccessProbeConfig::paper(1152, 40));
        let unknown = r#"{"features": 1152, "max_frames": 40, "layers": 1}"#;
        assert!(serde_json::from_str::<SuccessProbeConfig>(unknown).is_err());
    }
}
