//! Roles of networks, with their inputs and outputs.

use std::fmt;

/// Purpose of a network: its key in `networks.yaml`.
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
    /// Appeal of a picture.
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
    /// Points tracked through a video, such as CoTracker's.
    Tracks,
}

/// Input of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum InputKind {
    /// One picture.
    Picture,
    /// Two pictures, in two inputs.
    Pair,
    /// A clip of a fixed number of pictures.
    Clip,
    /// A clip if `input.frames` is given, else a picture.
    PictureOrClip,
    /// A video of any length and query points `N x 3`: step, x, y.
    Queries,
}

/// Output of a network, without the batch axis.
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
    /// `T x N x 2` positions (x, y) in pixels of the network's picture, and `T x N` visibilities.
    Tracks,
}

impl Role {
    /// All roles, in the order of reports.
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

    /// Key in `networks.yaml`.
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

    /// Metrics that need it, as in reports.
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

    /// Input of its network.
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

    /// Output of its network.
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

    /// Line of a report if the network is missing.
    ///
    /// ```
    /// use wm_evaluation::onnx::Role;
    /// assert_eq!(Role::Fid.not_measured(), "FID: not measured: no network for `fid`");
    /// ```
    pub fn not_measured(self) -> String {
        format!("{}: not measured: no network for `{self}`", self.metric())
    }

    /// Whether the output covers the picture, which must then not be cropped.
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
