use crate::onnx::Role;
use serde::{Deserialize, Serialize};

/// Features for comparing sets of frames or clips.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FeatureSpace {
    /// Inception's, of frames.
    Fid,
    /// A video network's, of clips.
    Fvd,
    /// A JEPA's, of frames or of clips.
    Jepa,
}

impl FeatureSpace {
    /// All.
    pub const ALL: [Self; 3] = [Self::Fid, Self::Fvd, Self::Jepa];

    /// Name in records.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fid => "fid",
            Self::Fvd => "fvd",
            Self::Jepa => "jepa",
        }
    }

    /// Role of its network.
    #[must_use]
    pub fn role(self) -> Role {
        match self {
            Self::Fid => Role::Fid,
            Self::Fvd => Role::Fvd,
            Self::Jepa => Role::Jepa,
        }
    }

    /// Names of its metrics.
    #[must_use]
    pub fn metrics(self) -> &'static [&'static str] {
        match self {
            Self::Fid => &["fid"],
            Self::Fvd => &["fvd"],
            Self::Jepa => &["jepa_similarity", "jepa_mmd"],
        }
    }
}
