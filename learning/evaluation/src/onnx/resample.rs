//! Resampling of a plane, as in PyTorch.

use crate::onnx::Resize;

/// One output element: weights of consecutive input elements.
struct Tap {
    start: usize,
    weights: Vec<f32>,
}

/// Resamples a row of `from` elements to `to`.
///
/// Weights as in PyTorch's `interpolate` with `align_corners=False` (`UpSample.h`, `UpSampleKernel.cpp`): with
/// antialias the kernel is stretched by the ratio when shrinking.
pub(crate) struct Taps {
    taps: Vec<Tap>,
}

impl Taps {
    pub(crate) fn new(from: usize, to: usize, resize: Resize, antialias: bool) -> Self {
        let ratio = from as f64 / to as f64;
        let tap = |i| match (resize, antialias) {
            (Resize::Bilinear, true) => averaged(from, i, ratio, 1.0, triangle),
            (Resize::Bicubic, true) => averaged(from, i, ratio, 2.0, |x| cubic(x, -0.5)),
            (Resize::Bilinear, false) => bilinear(from, i, ratio),
            (Resize::Bicubic, false) => bicubic(from, i, ratio),
            (Resize::Nearest | Resize::None, _) => Tap {
                start: ((i as f64 * ratio) as usize).min(from.saturating_sub(1)),
                weights: vec![1.0],
            },
        };
        Self {
            taps: (0..to).map(tap).collect(),
        }
    }

    /// Resamples every row of `plane`, of `from` elements with `channels` numbers each.
    pub(crate) fn rows(&self, plane: &[f32], from: usize, channels: usize) -> Vec<f32> {
        let rows = plane.len() / (from * channels).max(1);
        let mut out = Vec::with_capacity(rows * self.taps.len() * channels);
        for row in plane.chunks_exact((from * channels).max(1)) {
            self.onto(row, channels, &mut out);
        }
        out
    }

    /// Resamples the columns of `plane`, whose rows have `stride` numbers.
    pub(crate) fn columns(&self, plane: &[f32], stride: usize) -> Vec<f32> {
        let mut out = Vec::with_capacity(self.taps.len() * stride);
        self.onto(plane, stride, &mut out);
        out
    }

    /// Resamples one line of elements of `width` numbers each.
    fn onto(&self, line: &[f32], width: usize, out: &mut Vec<f32>) {
        for tap in &self.taps {
            let begin = out.len();
            out.resize(begin + width, 0.0);
            let Some(sum) = out.get_mut(begin..) else {
                continue;
            };
            let elements = line.chunks_exact(width.max(1)).skip(tap.start);
            for (element, weight) in elements.zip(&tap.weights) {
                for (sum, value) in sum.iter_mut().zip(element) {
                    *sum += weight * value;
                }
            }
        }
    }
}

/// Resizes a plane of `from` = (height, width) with `channels` numbers per pixel to `to`.
pub(crate) fn resized(
    plane: &[f32],
    from: [usize; 2],
    to: [usize; 2],
    channels: usize,
    (resize, antialias): (Resize, bool),
) -> Vec<f32> {
    let [from_height, from_width] = from;
    let [height, width] = to;
    let rows = Taps::new(from_width, width, resize, antialias).rows(plane, from_width, channels);
    Taps::new(from_height, height, resize, antialias).columns(&rows, width * channels)
}

/// Weights of a kernel with `support` elements on either side of output element `i`.
fn averaged(from: usize, i: usize, ratio: f64, support: f64, kernel: impl Fn(f64) -> f64) -> Tap {
    let stretch = ratio.max(1.0);
    let support = support * stretch;
    let center = ratio * (i as f64 + 0.5);
    // Casts to usize round down, and negative numbers to 0, as in PyTorch.
    let start = (center - support + 0.5) as usize;
    let end = ((center + support + 0.5) as usize).min(from);
    let mut weights: Vec<f64> = (start..end)
        .map(|j| kernel((j as f64 - center + 0.5) / stretch))
        .collect();
    let sum: f64 = weights.iter().sum();
    if sum != 0.0 {
        weights.iter_mut().for_each(|weight| *weight /= sum);
    }
    Tap {
        start,
        weights: weights.into_iter().map(|weight| weight as f32).collect(),
    }
}

fn bilinear(from: usize, i: usize, ratio: f64) -> Tap {
    let place = (ratio * (i as f64 + 0.5) - 0.5).max(0.0);
    let start = (place as usize).min(from.saturating_sub(1));
    let part = (place - start as f64) as f32;
    Tap {
        start,
        weights: if start + 1 < from {
            vec![1.0 - part, part]
        } else {
            vec![1.0]
        },
    }
}

/// Four neighbours; beyond the border, the outermost element repeats.
fn bicubic(from: usize, i: usize, ratio: f64) -> Tap {
    let place = ratio * (i as f64 + 0.5) - 0.5;
    let last = from.saturating_sub(1) as f64;
    let base = place.floor();
    let part = place - base;
    let start = (base - 1.0).clamp(0.0, last);
    let mut weights = [0.0; 4];
    for offset in [-1.0, 0.0, 1.0, 2.0] {
        // Within 0..4: the clamped index is at most 3 after the clamped first one.
        let at = ((base + offset).clamp(0.0, last) - start) as usize;
        if let Some(weight) = weights.get_mut(at) {
            *weight += cubic(offset - part, -0.75) as f32;
        }
    }
    Tap {
        start: start as usize,
        weights: weights.to_vec(),
    }
}

fn triangle(x: f64) -> f64 {
    (1.0 - x.abs()).max(0.0)
}

/// Keys' cubic convolution kernel.
fn cubic(x: f64, a: f64) -> f64 {
    let x = x.abs();
    if x < 1.0 {
        ((a + 2.0) * x - (a + 3.0)) * x * x + 1.0
    } else if x < 2.0 {
        (((x - 5.0) * x + 8.0) * x - 4.0) * a
    } else {
        0.0
    }
}
