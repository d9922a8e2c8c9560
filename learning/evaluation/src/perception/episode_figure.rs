use crate::onnx::Role;
use serde::{Deserialize, Serialize};
use wm_metrics::findings::Better;

/// A figure of one rollout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeFigure {
    Lpips,
    TLpips,
    ImageQuality,
    AestheticQuality,
    SubjectConsistency,
    BackgroundConsistency,
    DynamicDegree,
    DynamicDegreeSoft,
    FlowScore,
    FlowMean,
    PhotometricConsistency,
    DepthAbsRel,
    PckCoverage,
}

impl EpisodeFigure {
    /// All.
    pub const ALL: [Self; 13] = [
        Self::Lpips,
        Self::TLpips,
        Self::ImageQuality,
        Self::AestheticQuality,
        Self::SubjectConsistency,
        Self::BackgroundConsistency,
        Self::DynamicDegree,
        Self::DynamicDegreeSoft,
        Self::FlowScore,
        Self::FlowMean,
        Self::PhotometricConsistency,
        Self::DepthAbsRel,
        Self::PckCoverage,
    ];

    /// Name, also in records.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Lpips => "lpips",
            Self::TLpips => "t_lpips",
            Self::ImageQuality => "image_quality",
            Self::AestheticQuality => "aesthetic_quality",
            Self::SubjectConsistency => "subject_consistency",
            Self::BackgroundConsistency => "background_consistency",
            Self::DynamicDegree => "dynamic_degree",
            Self::DynamicDegreeSoft => "dynamic_degree_soft",
            Self::FlowScore => "flow_score",
            Self::FlowMean => "flow_mean",
            Self::PhotometricConsistency => "photometric_consistency",
            Self::DepthAbsRel => "depth_abs_rel",
            Self::PckCoverage => "pck_coverage",
        }
    }

    /// Meaning.
    #[must_use]
    pub fn about(self) -> &'static str {
        match self {
            Self::Lpips => {
                "LPIPS: learned perceptual distance to the true frames, mean over frames"
            }
            Self::TLpips => {
                "t-LPIPS: LPIPS of each frame to its successor, warped back by the true flow, against that of the true frames"
            }
            Self::ImageQuality => "image quality (MUSIQ), 0 to 1, mean over frames",
            Self::AestheticQuality => {
                "aesthetic quality (LAION's predictor), 0 to 1, mean over frames"
            }
            Self::SubjectConsistency => {
                "subject consistency: similarity of predicted frames' features to those of the first and of the previous frame"
            }
            Self::BackgroundConsistency => {
                "background consistency: similarity of predicted frames' features to those of the first and of the previous frame"
            }
            Self::DynamicDegree => {
                "dynamic degree: share of the pairs of predicted frames whose longest 5 % of flow exceed 6 px (the paper's text)"
            }
            Self::DynamicDegreeSoft => {
                "dynamic degree with a soft threshold, 6 px at a shorter side of 256 px (WorldArena's code)"
            }
            Self::FlowScore => {
                "flow score: mean length of the longest 5 % of all flow vectors of a rollout (the paper's text)"
            }
            Self::FlowMean => "flow score: mean length of all flow vectors (WorldArena's code)",
            Self::PhotometricConsistency => {
                "photometric consistency: distance of a pixel to itself after the flow to the next frame and back"
            }
            Self::DepthAbsRel => {
                "relative depth error of predicted frames against true frames, scaled to their median"
            }
            Self::PckCoverage => {
                "PCK coverage: share of 16x16 points of the first observed frame that are seen in predicted ones"
            }
        }
    }

    /// Roles of the networks that it needs.
    #[must_use]
    pub fn roles(self) -> &'static [Role] {
        match self {
            Self::Lpips => &[Role::Lpips],
            Self::TLpips => &[Role::Lpips, Role::Flow],
            Self::ImageQuality => &[Role::Musiq],
            Self::AestheticQuality => &[Role::Aesthetic],
            Self::SubjectConsistency => &[Role::Subject],
            Self::BackgroundConsistency => &[Role::Background],
            Self::DynamicDegree
            | Self::DynamicDegreeSoft
            | Self::FlowScore
            | Self::FlowMean
            | Self::PhotometricConsistency => &[Role::Flow],
            Self::DepthAbsRel => &[Role::Depth],
            Self::PckCoverage => &[Role::Tracks],
        }
    }

    /// Better direction, as in the paper's tables.
    #[must_use]
    pub fn better(self) -> Better {
        match self {
            Self::Lpips | Self::TLpips | Self::PhotometricConsistency | Self::DepthAbsRel => {
                Better::Lower
            }
            _ => Better::Higher,
        }
    }

    /// Unit.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::FlowScore | Self::FlowMean | Self::PhotometricConsistency => "px",
            _ => "",
        }
    }

    /// Title of its curve by step; `None` without one.
    #[must_use]
    pub fn curve(self) -> Option<&'static str> {
        match self {
            Self::Lpips => Some("LPIPS"),
            Self::PckCoverage => Some("PCK coverage"),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_match_the_records() {
        for figure in EpisodeFigure::ALL {
            assert_eq!(serde_json::to_value(figure).unwrap(), figure.name());
        }
    }
}
