//! Rotary position embedding: angles per position for the pairs of adjacent channels (2j, 2j + 1).

use candle_core::{D, Device, Result, Tensor};
use serde::{Deserialize, Serialize};

use super::reduction::dot;

/// Base of the geometric series of frequencies.
const BASE: f64 = 10_000.0;

/// Which column and view the places of several views get as rotary positions. The latents themselves always lie view by
/// view: the first view's columns, then the second's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RopeLayout {
    /// As the reference implementation does it, and so every published multi-view checkpoint: it unflattens the width
    /// into (columns, views), so that place c of V views gets column c / V and view c mod V.
    #[default]
    Reference,
    /// The column within the view and the view that the place is in.
    ByView,
}

impl RopeLayout {
    /// View and column of the place `place` along the width of `views` views of `width` columns each.
    fn view_and_column(self, place: usize, width: usize, views: usize) -> (usize, usize) {
        match self {
            Self::Reference => (place % views, place / views),
            Self::ByView => (place / width, place % width),
        }
    }
}

/// Cosines and sines of every position's angles.
#[derive(Clone, Debug)]
pub struct RotaryTable {
    /// Pairs of channels, half the head dimension.
    pairs: usize,
    /// cos then sin of each pair, position by position: (positions, 2, pairs).
    angles: Vec<f32>,
}

impl RotaryTable {
    /// One axis over all `head_dim` channels, for these positions.
    pub fn sequence(positions: &[usize], head_dim: usize) -> Self {
        let pairs = head_dim / 2;
        let frequencies = frequencies(pairs);
        let angles = positions
            .iter()
            .flat_map(|p| cos_sin(frequencies.iter().map(|f| f * *p as f64).collect()))
            .collect();
        Self { pairs, angles }
    }

    /// A grid in row-major order: the first half of the channels turns with the row, the second
    /// with the column.
    pub fn grid(height: usize, width: usize, head_dim: usize) -> Self {
        let pairs = head_dim / 2;
        let frequencies = frequencies(pairs / 2);
        let turned = |p: usize| frequencies.iter().map(move |f| f * p as f64);
        let angles = (0..height)
            .flat_map(|row| (0..width).map(move |column| (row, column)))
            .flat_map(|(row, column)| cos_sin(turned(row).chain(turned(column)).collect()))
            .collect();
        Self { pairs, angles }
    }

    /// Several views side by side, each a grid of `width` columns, in row-major order over the whole width. A third of
    /// the pairs of channels, rounded up, turns with the row, as many with the column, and the rest with the view
    /// (22 + 22 + 20 channels of 64); `layout` says which column and view a place has.
    pub fn views(
        height: usize,
        width: usize,
        views: usize,
        layout: RopeLayout,
        head_dim: usize,
    ) -> Self {
        let pairs = head_dim / 2;
        let third = pairs.div_ceil(3);
        let (by_place, by_view) = (frequencies(third), frequencies(pairs - 2 * third));
        let turned = |f: &[f64], p: usize| f.iter().map(|f| f * p as f64).collect::<Vec<_>>();
        let angles = (0..height)
            .flat_map(|row| (0..views * width).map(move |column| (row, column)))
            .flat_map(|(row, column)| {
                let (view, column) = layout.view_and_column(column, width, views);
                cos_sin(
                    [
                        turned(&by_place, row),
                        turned(&by_place, column),
                        turned(&by_view, view),
                    ]
                    .concat(),
                )
            })
            .collect();
        Self { pairs, angles }
    }

    /// Number of positions.
    pub fn len(&self) -> usize {
        self.angles.len() / (2 * self.pairs)
    }

    /// Head dimension that the table is for.
    pub(crate) fn head_dim(&self) -> usize {
        2 * self.pairs
    }

    /// Cosines and sines on `device`, each (positions, pairs).
    pub(crate) fn tensors(&self, device: &Device) -> Result<(Tensor, Tensor)> {
        let shape = (self.len(), 2, self.pairs);
        let angles = Tensor::from_slice(&self.angles, shape, device)?;
        let part = |i: usize| angles.narrow(1, i, 1)?.squeeze(1)?.contiguous();
        Ok((part(0)?, part(1)?))
    }

    /// Cosines and sines of one position, one of each per pair.
    #[inline(always)]
    pub(crate) fn at(&self, position: usize) -> (&[f32], &[f32]) {
        self.angles[position * 2 * self.pairs..][..2 * self.pairs].split_at(self.pairs)
    }
}

/// 10000^(-i / n) for i in 0..n.
fn frequencies(n: usize) -> Vec<f64> {
    (0..n).map(|i| BASE.powf(-(i as f64) / n as f64)).collect()
}

fn cos_sin(angles: Vec<f64>) -> impl Iterator<Item = f32> {
    let sines: Vec<f32> = angles.iter().map(|a| a.sin() as f32).collect();
    angles.into_iter().map(|a| a.cos() as f32).chain(sines)
}

/// Normalises one head's query or key by its root mean square and turns it by the angles of its
/// position.
///
/// `out` holds the first channels of all pairs, then the second ones: the same order for queries
/// and keys leaves their products as they are, and needs no shuffling in the products.
#[inline(always)]
pub(crate) fn normalise_and_rotate(x: &[f32], (cos, sin): (&[f32], &[f32]), out: &mut [f32]) {
    let r = inverse_rms(x);
    let (first, second) = out.split_at_mut(cos.len());
    let (pairs, _) = x.as_chunks::<2>();
    for ((([a, b], cos), sin), (first, second)) in pairs
        .iter()
        .zip(cos)
        .zip(sin)
        .zip(first.iter_mut().zip(second))
    {
        let (a, b) = (a * r, b * r);
        *first = a * cos - b * sin;
        *second = a * sin + b * cos;
    }
}

/// As [`normalise_and_rotate`], of `x` (.., positions, head dimension) by angles (positions, pairs), in the same order
/// of channels.
pub(crate) fn normalise_and_rotate_plain(
    x: &Tensor,
    (cos, sin): &(Tensor, Tensor),
) -> Result<Tensor> {
    let mean_square = x.sqr()?.mean_keepdim(D::Minus1)?;
    let normed = x.broadcast_div(&(mean_square + f64::from(f32::EPSILON))?.sqrt()?)?;
    let mut pairs = x.dims().to_vec();
    if let Some(last) = pairs.last_mut() {
        *last /= 2;
    }
    pairs.push(2);
    let pairs = normed.reshape(pairs)?;
    let half = |i: usize| pairs.narrow(D::Minus1, i, 1)?.squeeze(D::Minus1);
    let (a, b) = (half(0)?, half(1)?);
    let first = (a.broadcast_mul(cos)? - b.broadcast_mul(sin)?)?;
    let second = (a.broadcast_mul(sin)? + b.broadcast_mul(cos)?)?;
    Tensor::cat(&[first, second], D::Minus1)
}

/// Gradient of [`normalise_and_rotate`]: `grad` is that of its output, in its order of channels;
/// the gradient of `x` is written to `out`.
#[inline(always)]
pub(crate) fn normalise_and_rotate_backward(
    x: &[f32],
    (cos, sin): (&[f32], &[f32]),
    grad: &[f32],
    out: &mut [f32],
) {
    let r = inverse_rms(x);
    let (first, second) = grad.split_at(cos.len());
    let (turned, _) = out.as_chunks_mut::<2>();
    for ((([a, b], cos), sin), (first, second)) in turned
        .iter_mut()
        .zip(cos)
        .zip(sin)
        .zip(first.iter().zip(second))
    {
        *a = first * cos + second * sin;
        *b = second * cos - first * sin;
    }
    // With n = x r: the gradient is r (h - n mean(h n)), h being what is now in `out`.
    let factor = dot(out, x) * r * r * r / x.len() as f32;
    for (out, x) in out.iter_mut().zip(x) {
        *out = *out * r - x * factor;
    }
}

/// 1 / root mean square, with the machine epsilon of the number format against division by zero.
#[inline(always)]
fn inverse_rms(x: &[f32]) -> f32 {
    1.0 / (dot(x, x) / x.len() as f32 + f32::EPSILON).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reference_numbers_views_across_the_width() {
        let positions = |layout: RopeLayout| -> Vec<_> {
            (0..6).map(|c| layout.view_and_column(c, 3, 2)).collect()
        };
        // (view, column) of two views of three columns.
        let by_view = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)];
        assert_eq!(positions(RopeLayout::ByView), by_view);
        let reference = [(0, 0), (1, 0), (0, 1), (1, 1), (0, 2), (1, 2)];
        assert_eq!(positions(RopeLayout::Reference), reference);
    }
}
