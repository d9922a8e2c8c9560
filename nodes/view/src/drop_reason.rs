//! Why a message is dropped.

/// Why a message is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum DropReason {
    /// A predicted picture that matches no prediction.
    Unpaired,
    /// A prediction whose step or period is out of bounds.
    BadPrediction,
    /// Candidates with too many actions.
    LargeOffer,
    /// An invalid or outdated transform, or too many frames.
    BadTransform,
    /// An unknown fit.
    BadFit,
}

impl DropReason {
    /// As it is counted in the diagnostics.
    pub(crate) const fn reason(self) -> &'static str {
        match self {
            Self::Unpaired => "unpaired_picture",
            Self::BadPrediction => "bad_prediction",
            Self::LargeOffer => "large_offer",
            Self::BadTransform => "bad_transform",
            Self::BadFit => "bad_fit",
        }
    }

    /// For the log.
    pub(crate) const fn text(self) -> &'static str {
        match self {
            Self::Unpaired => {
                "a predicted picture came so late that nobody can tell of which prediction it is"
            }
            Self::BadPrediction => {
                "a prediction whose step is not 1 to 64, or whose step period is not positive"
            }
            Self::LargeOffer => "candidates with more actions than are kept",
            Self::BadTransform => {
                "a transform that is none, or older than the last one of its frame"
            }
            Self::BadFit => "the decoder's fit is not stretch, crop or pad",
        }
    }
}
