//! Attention over time for inference: the tokens of one frame attend to those at the same place in
//! earlier frames, and to themselves.
//!
//! A handful of keys a token: one vectorised pass over tokens and heads beats products of matrices.

use super::element::Float;
use super::exponential::exp;
use super::reduction::dot;
use super::rotary::{RotaryTable, normalise_and_rotate};
use super::vectorised::vectorised;

/// Keys (rows, d), normalised and turned, and values (rows, d) of the tokens of one frame.
pub(crate) type FrameRows<'a, T> = (&'a [T], &'a [T]);

vectorised! {
    /// Takes apart `qkv` (rows, 3 d) of one frame: queries and keys, normalised and turned by the
    /// only position of `angles`, and values, each (rows, d).
    pub(crate) fn split_rows<T: Float>(
        queries: &mut [f32],
        keys: &mut [T],
        values: &mut [T],
        qkv: &[f32],
        d: usize,
        angles: &RotaryTable,
    ) {
        let dim = angles.head_dim();
        let mut turned = vec![0.0; dim];
        let rows = queries.chunks_exact_mut(d).zip(keys.chunks_exact_mut(d));
        let rows = rows.zip(values.chunks_exact_mut(d)).zip(qkv.chunks_exact(3 * d));
        for (((queries, keys), values), qkv) in rows {
            let (q, kv) = qkv.split_at(d);
            let (k, v) = kv.split_at(d);
            for (from, to) in q.chunks_exact(dim).zip(queries.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles.at(0), to);
            }
            for (from, to) in k.chunks_exact(dim).zip(keys.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles.at(0), &mut turned);
                for (to, value) in to.iter_mut().zip(&turned) {
                    *to = T::from_f32(*value);
                }
            }
            for (to, value) in values.iter_mut().zip(v) {
                *to = T::from_f32(*value);
            }
        }
    }
}

vectorised! {
    /// Attention of `queries` (rows, d) with heads of `dim` channels to the `frames`, to `out`
    /// (rows, d). `weights` is scratch, a value a frame.
    pub(crate) fn attend_rows<T: Float>(
        out: &mut [f32],
        queries: &[f32],
        frames: &[FrameRows<'_, T>],
        weights: &mut [f32],
        d: usize,
        dim: usize,
    ) {
        let scale = 1.0 / (dim as f32).sqrt();
        let pairs = out.chunks_exact_mut(d).zip(queries.chunks_exact(d));
        for (row, (out, query)) in pairs.enumerate() {
            let heads = out.chunks_exact_mut(dim).zip(query.chunks_exact(dim));
            for (head, (out, query)) in heads.enumerate() {
                let start = row * d + head * dim;
                for (weight, (k, _)) in weights.iter_mut().zip(frames) {
                    *weight = dot(query, &k[start..][..dim]) * scale;
                }
                softmax(weights);
                out.fill(0.0);
                for (weight, (_, v)) in weights.iter().zip(frames) {
                    for (out, v) in out.iter_mut().zip(&v[start..][..dim]) {
                        *out = weight.mul_add(v.to_f32(), *out);
                    }
                }
            }
        }
    }
}

/// Softmax in place, for so few weights that lanes would stay empty.
#[inline(always)]
fn softmax(weights: &mut [f32]) {
    let most = weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut sum = 0.0;
    for weight in weights.iter_mut() {
        *weight = exp(*weight - most);
        sum += *weight;
    }
    for weight in weights {
        *weight /= sum;
    }
}
