//! What `networks.yaml` says of one network.

mod check;

use std::path::PathBuf;

use serde::Deserialize;

use crate::onnx::Digest;

pub(crate) use check::MAX_BATCH;

/// One network: its file, what it takes and where its result is. See `networks.example.yaml` in this crate's folder for every key.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    /// The ONNX file, relative to the folder of `networks.yaml`.
    pub file: PathBuf,
    /// The file's SHA-256. Default: any file will do.
    pub sha256: Option<Digest>,
    /// What becomes of a picture before the network sees it.
    pub input: Input,
    /// The output with the result; for `tracks`, with the places. Default: the first.
    #[serde(default)]
    pub output: Output,
    /// What becomes of axes between batch and features. Default: there are none.
    #[serde(default)]
    pub pooling: Pooling,
    /// Scores that become 0 and 1, for `musiq` and `aesthetic`. Default for `aesthetic`: 0 and 10; `musiq` has none.
    pub score_range: Option<[f32; 2]>,
    /// For `tracks`: the output with the visibilities. Default: the second.
    pub visibility: Option<Output>,
    /// For `tracks`: a point is visible where its visibility is above this. Default: 0.5.
    pub visible_above: Option<f32>,
    /// Pictures, pairs or clips per run, 1 to 64, where the file does not fix it. Default: 1; with more, the last bits of what a
    /// picture gives may depend on its place among the others.
    #[serde(default = "one")]
    pub batch: usize,
}

/// What becomes of a picture before the network sees it: resize, centre crop, range, mean and deviation, layout.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// How pictures are resized.
    pub resize: Resize,
    /// Size after the resize. With `resize: none`, the size that pictures must have; default there: any.
    pub size: Option<Size>,
    /// Whether a smaller picture averages over the larger one. Must be said for `bilinear` and `bicubic`.
    pub antialias: Option<bool>,
    /// Height and width that are cut out of the middle after the resize. Default: nothing is cut off.
    pub crop: Option<[usize; 2]>,
    /// What levels 0 and 255 become, before mean and deviation.
    pub range: [f32; 2],
    /// Subtracted from each channel, in the order of `channels`. Default: 0.
    #[serde(default)]
    pub mean: [f32; 3],
    /// Divides each channel, in the order of `channels`. Default: 1.
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

/// How a picture is resized, as PyTorch's `interpolate` with `align_corners=False` does. With antialias the bicubic kernel has
/// `a = -0.5`, without it `a = -0.75`, as there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Resize {
    /// Straight lines between neighbours.
    Bilinear,
    /// Cubic polynomials through four neighbours.
    Bicubic,
    /// The neighbour at or before each place: PyTorch's `nearest`, not its `nearest-exact`.
    Nearest,
    /// Not at all.
    None,
}

/// Size of a picture after the resize.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a number for the shorter side, or [height, width]"
)]
pub enum Size {
    /// The shorter side; the longer one keeps the ratio, rounded down, as torchvision's `Resize` with one number.
    Shorter(usize),
    /// Height and width.
    Exact([usize; 2]),
}

/// Order of the axes of an input: n batch, c colour, t time, h height, w width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Pictures, a plane per colour.
    Nchw,
    /// Pictures, the colours of a pixel together.
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

/// One of the outputs of a network.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the number of an output, from 0, or its name"
)]
pub enum Output {
    /// By its place, from 0.
    Index(usize),
    /// By its name.
    Name(String),
}

impl Default for Output {
    fn default() -> Self {
        Self::Index(0)
    }
}

/// What becomes of axes between batch and features. Axes of one element need none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// The output is `batch x features` already.
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
