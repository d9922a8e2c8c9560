//! What a network is for, and what it takes and gives.

use std::fmt;

/// What a network is for: its key in `networks.yaml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Perceptual distance of two pictures.
    Lpips,
    /// Features of pictures for the Fréchet inception distance.
    Fid,
    /// Features of clips for the Fréchet video distance.
    Fvd,
    /// Technical quality of a picture.
    Musiq,
    /// How well a picture pleases.
    Aesthetic,
    /// Features for the maximum mean discrepancy in a JEPA's space.
    Jepa,
    /// Features that follow the subject of a clip, such as DINO's.
    Subject,
    /// Features that follow the background of a clip, such as CLIP's.
    Background,
    /// Optical flow, such as RAFT's.
    Flow,
    /// Depth of a single picture.
    Depth,
    /// Points followed through a video, such as CoTracker's.
    Tracks,
}

/// What a network takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum InputKind {
    /// One picture.
    Picture,
    /// Two pictures, in two inputs.
    Pair,
    /// A clip of a fixed number of pictures.
    Clip,
    /// A clip where `input.frames` is given, else a picture.
    PictureOrClip,
    /// A video of any length and query points `N x 3`: step, x, y.
    Queries,
}

/// What a network gives, without the leading batch axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum OutputKind {
    /// A vector of `D` features.
    Features,
    /// A number: a score or a distance.
    Scalar,
    /// `2 x H x W`: displacement to the right and down, in pixels of the network's picture.
    Flow,
    /// `H x W` or `1 x H x W`, in the network's unit.
    Depth,
    /// `T x N x 2` places (x, y) in pixels of the network's picture, and `T x N` visibilities.
    Tracks,
}

impl Role {
    /// Every role, in the order in which reports list them.
    pub const ALL: [Self; 11] = [
        Self::Lpips,
        Self::Fid,
        Self::Fvd,
        Self::Musiq,
        Self::Aesthetic,
        Self::Jepa,
        Self::Subject,
        Self::Background,
        Self::Flow,
        Self::Depth,
        Self::Tracks,
    ];

    /// Its key in `networks.yaml`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lpips => "lpips",
            Self::Fid => "fid",
            Self::Fvd => "fvd",
            Self::Musiq => "musiq",
            Self::Aesthetic => "aesthetic",
            Self::Jepa => "jepa",
            Self::Subject => "subject",
            Self::Background => "background",
            Self::Flow => "flow",
            Self::Depth => "depth",
            Self::Tracks => "tracks",
        }
    }

    /// The metrics that need it, as reports name them.
    pub fn metric(self) -> &'static str {
        match self {
            Self::Lpips => "LPIPS",
            Self::Fid => "FID",
            Self::Fvd => "FVD",
            Self::Musiq => "image quality",
            Self::Aesthetic => "aesthetic quality",
            Self::Jepa => "JEPA similarity",
            Self::Subject => "subject consistency",
            Self::Background => "background consistency",
            Self::Flow => "t-LPIPS, dynamic degree and flow score",
            Self::Depth => "depth accuracy",
            Self::Tracks => "PCK coverage",
        }
    }

    /// What its network takes.
    pub fn input(self) -> InputKind {
        match self {
            Self::Lpips | Self::Flow => InputKind::Pair,
            Self::Fvd => InputKind::Clip,
            Self::Jepa => InputKind::PictureOrClip,
            Self::Tracks => InputKind::Queries,
            Self::Fid
            | Self::Musiq
            | Self::Aesthetic
            | Self::Subject
            | Self::Background
            | Self::Depth => InputKind::Picture,
        }
    }

    /// What its network gives.
    pub fn output(self) -> OutputKind {
        match self {
            Self::Fid | Self::Fvd | Self::Jepa | Self::Subject | Self::Background => {
                OutputKind::Features
            }
            Self::Lpips | Self::Musiq | Self::Aesthetic => OutputKind::Scalar,
            Self::Flow => OutputKind::Flow,
            Self::Depth => OutputKind::Depth,
            Self::Tracks => OutputKind::Tracks,
        }
    }

    /// The line of a report that stands for what this role would have measured.
    ///
    /// ```
    /// use crate::onnx::Role;
    /// assert_eq!(Role::Fid.not_measured(), "FID: not measured: no network for `fid`");
    /// ```
    pub fn not_measured(self) -> String {
        format!("{}: not measured: no network for `{self}`", self.metric())
    }

    /// Whether the output lies on the picture, so that nothing of the picture may be cut off.
    pub(crate) fn is_on_the_picture(self) -> bool {
        matches!(
            self.output(),
            OutputKind::Flow | OutputKind::Depth | OutputKind::Tracks
        )
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
