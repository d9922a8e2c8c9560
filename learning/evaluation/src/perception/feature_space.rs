use crate::onnx::Role;
use serde::{Deserialize, Serialize};

/// Features that two sets of frames, or of clips, are compared in.
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

    /// Its name in records.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fid => "fid",
            Self::Fvd => "fvd",
            Self::Jepa => "jepa",
        }
    }

    /// Whose network gives them.
    #[must_use]
    pub fn role(self) -> Role {
        match self {
            Self::Fid => Role::Fid,
            Self::Fvd => Role::Fvd,
            Self::Jepa => Role::Jepa,
        }
    }

    /// Names of the metrics that are of them.
    #[must_use]
    pub fn metrics(self) -> &'static [&'static str] {
        match self {
            Self::Fid => &["fid"],
            Self::Fvd => &["fvd"],
            Self::Jepa => &["jepa_similarity", "jepa_mmd"],
        }
    }
}
