//! Descriptions in `networks.yaml`.

mod check;

use std::path::PathBuf;

use serde::Deserialize;

use crate::onnx::Digest;

pub(crate) use check::MAX_BATCH;

/// One network: file, input and output. `networks.example.yaml` in this crate's folder has every key.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    /// The ONNX file, relative to the folder of `networks.yaml`.
    pub file: PathBuf,
    /// SHA-256 of the file. Default: not verified.
    pub sha256: Option<Digest>,
    /// Preparation of pictures.
    pub input: Input,
    /// Output with the result; for `tracks`, with the positions. Default: the first.
    #[serde(default)]
    pub output: Output,
    /// Pooling of axes between batch and features. Default: none.
    #[serde(default)]
    pub pooling: Pooling,
    /// Scores that map to 0 and 1, for `musiq` and `aesthetic`. Default for `aesthetic`: 0 and 10; `musiq` has none.
    pub score_range: Option<[f32; 2]>,
    /// For `tracks`: output with the visibilities. Default: the second.
    pub visibility: Option<Output>,
    /// For `tracks`: least visibility of a visible point. Default: 0.5.
    pub visible_above: Option<f32>,
    /// Pictures, pairs or clips per run, 1 to 64, unless fixed by the file. Default: 1. With more, the last bits of a result may
    /// depend on the position in the batch.
    #[serde(default = "one")]
    pub batch: usize,
}

/// Preparation of a picture: resize, centre crop, range, mean and deviation, layout.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Resizing.
    pub resize: Resize,
    /// Size after the resize. With `resize: none`, the required size; default there: any.
    pub size: Option<Size>,
    /// Whether shrinking averages. Required for `bilinear` and `bicubic`.
    pub antialias: Option<bool>,
    /// Height and width of the centre crop after the resize. Default: no crop.
    pub crop: Option<[usize; 2]>,
    /// Values of levels 0 and 255, before mean and deviation.
    pub range: [f32; 2],
    /// Subtracted by channel, in the order of `channels`. Default: 0.
    #[serde(default)]
    pub mean: [f32; 3],
    /// Divisor by channel, in the order of `channels`. Default: 1.
    #[serde(default = "ones")]
    pub std: [f32; 3],
    /// Order of the axes. Default: `nchw` for pictures, `ncthw` for clips, `ntchw` for `tracks`.
    pub layout: Option<Layout>,
    /// Order of the colours. Default: `rgb`.
    #[serde(default)]
    pub channels: Channels,
    /// Pictures per clip, for `fvd` (default: 16) and `jepa` (default: pictures, not clips).
    pub frames: Option<usize>,
}

/// Resizing as in PyTorch's `interpolate` with `align_corners=False`. The bicubic kernel has `a = -0.5` with antialias,
/// and `a = -0.75` without.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Linear interpolation.
    Bilinear,
    /// Cubic interpolation of four neighbours.
    Bicubic,
    /// The neighbour at or before each position: PyTorch's `nearest`, not its `nearest-exact`.
    Nearest,
    /// No resizing.
    None,
}

/// Size of a picture after the resize.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number for the shorter side, or [height, width]"
)]
pub enum Size {
    /// The shorter side; the longer one keeps the ratio, rounded down, as in torchvision's `Resize`.
    Shorter(usize),
    /// Height and width.
    Exact([usize; 2]),
}

/// Axes of an input: n batch, c colour, t time, h height, w width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Pictures by colour plane.
    Nchw,
    /// Pictures with interleaved colours.
    Nhwc,
    /// Clips, time within colour.
    Ncthw,
    /// Clips, colour within time.
    Ntchw,
}

/// Order of the colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Channels {
    /// Red first.
    #[default]
    Rgb,
    /// Blue first.
    Bgr,
}

/// An output of a network.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the number of an output, from 0, or its name"
)]
pub enum Output {
    /// By index, from 0.
    Index(usize),
    /// By name.
    Name(String),
}

impl Default for Output {
    fn default() -> Self {
        Self::Index(0)
    }
}

/// Pooling of axes between batch and features. Axes of one element need none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// The output is `batch x features`.
    #[default]
    None,
    /// Mean over the tokens of `batch x tokens x features`.
    Tokens,
    /// The first token of `batch x tokens x features`, often called CLS.
    FirstToken,
    /// Mean over all but the first two axes: `batch x features x height x width`, or with time.
    Space,
}

fn one() -> usize {
    1
}

fn ones() -> [f32; 3] {
    [1.0; 3]
}
