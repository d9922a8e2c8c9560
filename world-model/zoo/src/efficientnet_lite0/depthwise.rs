//! The depthwise convolution on the CPU.
//!
//! Channels are last and each by itself, so a tap is one multiply-add of a pixel's channels with
//! the tap's: long contiguous rows, no transposition, and one task per output row. candle would run
//! one convolution per channel.

use candle_core::{CpuStorage, CustomOp1, DType, Layout, Result, Shape, Tensor};
use rayon::prelude::*;

use super::window::Window;

/// A depthwise convolution of (N, H, W, C).
pub(super) struct DepthwiseKernel {
    /// (kernel, kernel, C).
    taps: Vec<f32>,
    /// (C).
    bias: Vec<f32>,
    window: Window,
}

impl DepthwiseKernel {
    /// `weight` is (C, 1, kernel, kernel), `bias` (C).
    pub(super) fn new(weight: &Tensor, bias: &Tensor, window: Window) -> Result<Self> {
        let values = |x: &Tensor| x.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>();
        Ok(Self {
            taps: values(&weight.permute((2, 3, 1, 0))?.contiguous()?)?,
            bias: values(bias)?,
            window,
        })
    }

    /// One output row `out` (W', C) of a picture (H, W, C).
    fn row(&self, picture: &[f32], (h, w): (usize, usize), at: usize, out: &mut [f32]) {
        let channels = self.bias.len();
        let Window { kernel, stride } = self.window;
        let (_, top, _) = self.window.along(h);
        let (_, left, _) = self.window.along(w);
        let rows = picture.chunks_exact(w * channels);
        for (row, input) in rows.enumerate() {
            let Some(ky) = (row + top).checked_sub(at * stride) else {
                continue;
            };
            let Some(taps) = self.taps.chunks_exact(kernel * channels).nth(ky) else {
                break;
            };
            for (column, out) in out.chunks_exact_mut(channels).enumerate() {
                for (kx, taps) in taps.chunks_exact(channels).enumerate() {
                    let Some(x) = (column * stride + kx).checked_sub(left) else {
                        continue;
                    };
                    let Some(pixel) = input.get(x * channels..(x + 1) * channels) else {
                        continue;
                    };
                    for ((out, tap), value) in out.iter_mut().zip(taps).zip(pixel) {
                        *out += tap * value;
                    }
                }
            }
        }
    }
}

impl CustomOp1 for DepthwiseKernel {
    fn name(&self) -> &'static str {
        "depthwise convolution"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (n, h, w, channels) = layout.shape().dims4()?;
        if channels != self.bias.len() || channels == 0 || h * w == 0 {
            candle_core::bail!(
                "depthwise convolution of {:?} with {} channels",
                layout.shape(),
                self.bias.len()
            );
        }
        let values = storage.as_slice::<f32>()?;
        let Some(x) = layout
            .contiguous_offsets()
            .and_then(|(start, end)| values.get(start..end))
        else {
            candle_core::bail!("depthwise convolution of a tensor with gaps");
        };
        let (rows, _, _) = self.window.along(h);
        let (columns, _, _) = self.window.along(w);
        let mut out = Vec::with_capacity(n * rows * columns * channels);
        for _ in 0..n * rows * columns {
            out.extend_from_slice(&self.bias);
        }
        let pictures = out.par_chunks_exact_mut(rows * columns * channels);
        pictures
            .zip(x.par_chunks_exact(h * w * channels))
            .for_each(|(out, picture)| {
                out.par_chunks_exact_mut(columns * channels)
                    .enumerate()
                    .for_each(|(at, out)| self.row(picture, (h, w), at, out));
            });
        Ok((CpuStorage::F32(out), (n, rows, columns, channels).into()))
    }
}
