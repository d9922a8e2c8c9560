//! Attention of one head over one sequence, in buffers that stay in cache.

use super::product::{LANES, Left, product, transpose};
use crate::ops::exponential::exp;
use crate::ops::reduction::{dot, largest, replace_and_sum};
use crate::ops::rotary::{RotaryTable, normalise_and_rotate, normalise_and_rotate_backward};
use crate::ops::simd::prefetch;

/// Rows ahead that are asked for. A head's channels are a few cache lines of each row, far apart, which the processor does
/// not foresee: without, half of the gradient's time was waiting for them.
const AHEAD: usize = 8;

/// One head of a sequence within a group: token `i` is row `sequence + i * stride`, of `d` values.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) sequence: usize,
    pub(super) stride: usize,
    pub(super) d: usize,
    pub(super) head: usize,
}

impl Place {
    #[inline(always)]
    fn row(self, token: usize) -> usize {
        self.sequence + token * self.stride
    }

    /// Asks for the head's channels of a coming row, in `parts` parts of `d` values.
    #[inline(always)]
    fn prefetch(self, rows: &[f32], token: usize, parts: usize, dim: usize) {
        let row = self.row(token + AHEAD) * parts * self.d;
        for part in 0..parts {
            if let Some(values) = rows.get(row + part * self.d + self.head * dim..) {
                prefetch(&values[..dim.min(values.len())]);
            }
        }
    }
}

/// Buffers for one head; rows are tokens.
pub(super) struct HeadKernel<'a> {
    rotary: &'a RotaryTable,
    bias: &'a [f32],
    length: usize,
    /// The length rounded up to whole lanes.
    padded: usize,
    /// Channels of a head.
    dim: usize,
    /// The channels rounded up to whole lanes: the width of the buffers' rows. Those beyond stay 0.
    wide: usize,
    scale: f32,
    query: Vec<f32>,
    key: Vec<f32>,
    value: Vec<f32>,
    /// The transposed keys, or values; columns beyond the length stay 0.
    across: Vec<f32>,
    weights: Vec<f32>,
    out: Vec<f32>,
    grad_weights: Vec<f32>,
    grad_query: Vec<f32>,
    grad_key: Vec<f32>,
    grad_value: Vec<f32>,
}

impl<'a> HeadKernel<'a> {
    pub(super) fn new(rotary: &'a RotaryTable, bias: &'a [f32]) -> Self {
        let (length, dim) = (rotary.len(), rotary.head_dim());
        let padded = length.next_multiple_of(LANES);
        let wide = dim.next_multiple_of(LANES);
        let tokens = || vec![0.0; length * wide];
        Self {
            rotary,
            bias,
            length,
            padded,
            dim,
            wide,
            scale: 1.0 / (dim as f32).sqrt(),
            query: tokens(),
            key: tokens(),
            value: tokens(),
            across: vec![0.0; wide * padded],
            weights: vec![0.0; length * padded],
            out: tokens(),
            grad_weights: vec![0.0; length * padded],
            grad_query: tokens(),
            grad_key: tokens(),
            grad_value: tokens(),
        }
    }

    /// Takes one head's queries, keys and values of a sequence out of rows q | k | v of 3 `d`.
    #[inline(always)]
    pub(super) fn load(&mut self, qkv: &[f32], place: Place) {
        let dim = self.dim;
        let Place { d, head, .. } = place;
        for i in 0..self.length {
            place.prefetch(qkv, i, 3, dim);
            let row = &qkv[place.row(i) * 3 * d..][..3 * d];
            let angles = self.rotary.at(i);
            let out = i * self.wide;
            let query = &row[head * dim..][..dim];
            normalise_and_rotate(query, angles, &mut self.query[out..][..dim]);
            let key = &row[d + head * dim..][..dim];
            normalise_and_rotate(key, angles, &mut self.key[out..][..dim]);
            let value = &row[2 * d + head * dim..][..dim];
            self.value[out..][..dim].copy_from_slice(value);
        }
    }

    /// Writes the result of [`Self::forward`] to rows of `d`.
    #[inline(always)]
    pub(super) fn store(&self, out: &mut [f32], place: Place) {
        let dim = self.dim;
        for (i, row) in self.out.chunks_exact(self.wide).enumerate() {
            out[place.row(i) * place.d + place.head * dim..][..dim].copy_from_slice(&row[..dim]);
        }
    }

    /// Takes the gradient of the result out of rows of `d`.
    #[inline(always)]
    pub(super) fn load_grad(&mut self, grad: &[f32], place: Place) {
        let dim = self.dim;
        for (i, row) in self.out.chunks_exact_mut(self.wide).enumerate() {
            place.prefetch(grad, i, 1, dim);
            let grad = &grad[place.row(i) * place.d + place.head * dim..][..dim];
            row[..dim].copy_from_slice(grad);
        }
    }

    /// Writes the gradients of [`Self::backward`] to rows of 3 `d`.
    #[inline(always)]
    pub(super) fn store_grad(&self, out: &mut [f32], qkv: &[f32], place: Place) {
        let dim = self.dim;
        let Place { d, head, .. } = place;
        for i in 0..self.length {
            place.prefetch(out, i, 3, dim);
            let start = place.row(i) * 3 * d;
            let row = &qkv[start..][..3 * d];
            let out = &mut out[start..][..3 * d];
            let angles = self.rotary.at(i);
            let first = i * self.wide;
            normalise_and_rotate_backward(
                &row[head * dim..][..dim],
                angles,
                &self.grad_query[first..][..dim],
                &mut out[head * dim..][..dim],
            );
            normalise_and_rotate_backward(
                &row[d + head * dim..][..dim],
                angles,
                &self.grad_key[first..][..dim],
                &mut out[d + head * dim..][..dim],
            );
            out[2 * d + head * dim..][..dim].copy_from_slice(&self.grad_value[first..][..dim]);
        }
    }

    /// The softmax of the scaled scores.
    #[inline(always)]
    fn weigh(&mut self) {
        transpose(self.wide, &self.key, self.padded, &mut self.across);
        product(
            (self.length, self.dim, self.padded),
            Left::rows(&self.query, self.wide),
            &self.across,
            &mut self.weights,
        );
        let rows = self.weights.chunks_exact_mut(self.padded);
        for (row, bias) in rows.zip(self.bias.chunks_exact(self.padded)) {
            softmax(row, bias, self.scale);
        }
    }

    /// Attention of what was loaded.
    #[inline(always)]
    pub(super) fn forward(&mut self) {
        self.weigh();
        product(
            (self.length, self.length, self.wide),
            Left::rows(&self.weights, self.padded),
            &self.value,
            &mut self.out,
        );
    }

    /// Gradients of what was loaded, `out` being the gradient of the result.
    #[inline(always)]
    pub(super) fn backward(&mut self) {
        self.weigh();
        let of_tokens = (self.length, self.length, self.wide);
        product(
            of_tokens,
            Left::transposed(&self.weights, self.padded),
            &self.out,
            &mut self.grad_value,
        );
        transpose(self.wide, &self.value, self.padded, &mut self.across);
        product(
            (self.length, self.dim, self.padded),
            Left::rows(&self.out, self.wide),
            &self.across,
            &mut self.grad_weights,
        );
        let rows = self.grad_weights.chunks_exact_mut(self.padded);
        for (grad, weights) in rows.zip(self.weights.chunks_exact(self.padded)) {
            softmax_backward(grad, weights, self.scale);
        }
        product(
            of_tokens,
            Left::rows(&self.grad_weights, self.padded),
            &self.key,
            &mut self.grad_query,
        );
        product(
            of_tokens,
            Left::transposed(&self.grad_weights, self.padded),
            &self.query,
            &mut self.grad_key,
        );
    }
}

/// Softmax of `scale` * `row` + `bias` in place.
#[inline(always)]
fn softmax(row: &mut [f32], bias: &[f32], scale: f32) {
    for (score, bias) in row.iter_mut().zip(bias) {
        *score = score.mul_add(scale, *bias);
    }
    let most = largest(row);
    let sum = replace_and_sum(row, |score| {
        // Masked entries must be exactly 0, which `exp` of -inf is not quite.
        if score == f32::NEG_INFINITY {
            0.0
        } else {
            exp(score - most)
        }
    });
    let inverse = 1.0 / sum;
    for weight in row {
        *weight *= inverse;
    }
}

/// Turns the gradient of the softmax's result into that of the unscaled scores.
#[inline(always)]
fn softmax_backward(grad: &mut [f32], weights: &[f32], scale: f32) {
    let mean = dot(grad, weights);
    for (grad, weight) in grad.iter_mut().zip(weights) {
        *grad = weight * (*grad - mean) * scale;
    }
}
