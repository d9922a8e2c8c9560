//! Attention within a frame for inference: the frame's tokens are cut into blocks, each block's
//! keys and values are packed for the kernel of matrix products, and a block of queries attends to
//! all of them.
//!
//! Blocks are what threads share: each projects its own tokens, and then reads the keys and values
//! of all. The cut depends on the number of tokens only, so results do not depend on the threads.

use super::element::{Element, Float};
use super::kernel::{Prefetch, Product, Row};
use super::rotary::{RotaryTable, normalise_and_rotate};
use super::simd::{InstructionSet, LANES, NO_BIAS};
use super::softmax::softmax_rows;
use super::vectorised::vectorised;

/// Tokens of a block at most: enough rows for a packed weight to be read rarely, few enough for the
/// block's activations to stay in a second-level cache.
const MOST_TOKENS: usize = 64;

/// How a frame's tokens are cut into blocks, and the sizes of what is packed of each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TokenBlocks {
    tokens: usize,
    /// Tokens of a block, but perhaps of the last; a multiple of [`LANES`].
    block: usize,
    heads: usize,
    dim: usize,
    /// Vectors in a panel of keys, and in one of values.
    key_vectors: usize,
    value_vectors: usize,
}

/// Packed keys and values of one block of tokens.
pub(crate) type Packed<'a, T> = (&'a [T], &'a [T]);

impl TokenBlocks {
    /// For frames of `tokens` tokens, `heads` heads of `dim` channels.
    pub(crate) fn new(tokens: usize, heads: usize, dim: usize) -> Self {
        // Two blocks at least, for two threads, where they are of a useful size.
        let block = tokens
            .div_ceil(2)
            .next_multiple_of(LANES)
            .clamp(LANES, MOST_TOKENS);
        let most = InstructionSet::detect().tile_vectors();
        // Panels of equal widths.
        let vectors = |channels: usize| {
            let all = channels.div_ceil(LANES);
            let fits = |vectors: &usize| all.is_multiple_of(*vectors);
            (1..=most).rev().find(fits).unwrap_or(1)
        };
        Self {
            tokens,
            block,
            heads,
            dim,
            key_vectors: vectors(block),
            value_vectors: vectors(dim),
        }
    }

    /// Number of blocks.
    pub(crate) fn count(&self) -> usize {
        self.tokens.div_ceil(self.block)
    }

    /// Places for tokens in every block.
    pub(crate) fn block(&self) -> usize {
        self.block
    }

    /// Tokens of block `i`.
    pub(crate) fn tokens_of(&self, i: usize) -> usize {
        self.tokens.saturating_sub(i * self.block).min(self.block)
    }

    /// Values of a token.
    pub(crate) fn width(&self) -> usize {
        self.heads * self.dim
    }

    /// Channels of a head in whole panels.
    fn padded_dim(&self) -> usize {
        self.dim.next_multiple_of(LANES)
    }

    /// Values of a block's packed keys.
    pub(crate) fn key_values(&self) -> usize {
        self.heads * self.dim * self.block
    }

    /// Values of a block's packed values.
    pub(crate) fn value_values(&self) -> usize {
        self.heads * self.padded_dim() * self.block
    }

    /// Values of the scratch that [`Self::attend`] needs.
    pub(crate) fn score_values(&self) -> usize {
        self.block * self.count() * self.block
    }

    /// Takes apart the rows `qkv` (n, 3 d) of block `i`: queries (n, d), normalised, turned and
    /// scaled, and packed keys and values.
    pub(crate) fn pack<P: Product>(
        &self,
        i: usize,
        qkv: &[f32],
        rotary: &RotaryTable,
        queries: &mut [P::Input],
        (keys, values): (&mut [P::Weight], &mut [P::Weight]),
    ) {
        pack_rows::<P>(self, i * self.block, qkv, rotary, queries, keys, values);
    }

    /// Attention of `queries` (n, d) to the tokens of all blocks, to `out` (n, d), by `unit`. What keys and values have
    /// beyond the tokens must be zeros.
    ///
    /// # Panics
    /// If a slice has another size.
    pub(crate) fn attend<'a, P: Product<Scales = ()>>(
        &self,
        unit: P::Unit,
        queries: &[P::Input],
        packed: impl Fn(usize) -> Packed<'a, P::Weight>,
        scores: &mut [f32],
        out: &mut [f32],
    ) where
        P::Input: Float,
    {
        let (d, dim, block) = (self.width(), self.dim, self.block);
        let rows = queries.len() / d.max(1);
        let pitch = self.count() * block;
        // The kernel trusts these.
        assert!(rows <= block && out.len() == rows * d && queries.len() == rows * d);
        assert!(scores.len() >= rows * pitch, "scratch for scores");
        assert!(dim.is_multiple_of(P::Weight::GROUP), "whole groups");
        out.fill(0.0);
        let row = Row::<P> {
            input: queries.as_ptr(),
            input_step: d,
            tap_pitch: 0,
            tap_rows: 1,
            run: dim,
            panel: std::ptr::null(),
            vectors: self.key_vectors,
            bias: NO_BIAS.as_ptr(),
            scales: (),
            pixels: rows,
            output: std::ptr::null_mut(),
            residual: std::ptr::null(),
            mask: std::ptr::null(),
            output_step: pitch,
            channels: self.key_vectors * LANES,
            relu: false,
            accumulates: false,
            prefetch: Prefetch::NOTHING,
        };
        let (key_width, value_width) = (self.key_vectors * LANES, self.value_vectors * LANES);
        for head in 0..self.heads {
            for other in 0..self.count() {
                let (keys, _) = packed(other);
                assert_eq!(keys.len(), self.key_values(), "packed keys");
                for column in (0..block).step_by(key_width) {
                    let at = head * dim * block + column * dim;
                    let row = Row {
                        input: queries.as_ptr().wrapping_add(head * dim),
                        panel: keys.as_ptr().wrapping_add(at),
                        output: scores.as_mut_ptr().wrapping_add(other * block + column),
                        scales: (),
                        ..row
                    };
                    // SAFETY: the lengths were checked above; a head's keys are `dim * block`
                    // values, of which a panel takes `dim * key_width`, and `key_width` divides
                    // `block`.
                    unsafe { row.run(unit) };
                }
            }
            let scores = scores.get_mut(..rows * pitch).unwrap_or_default();
            softmax_rows(scores, pitch, self.tokens);
            P::Input::with_rounded(scores, |scores| {
                for other in 0..self.count() {
                    let (_, values) = packed(other);
                    assert_eq!(values.len(), self.value_values(), "packed values");
                    for channel in (0..dim).step_by(value_width) {
                        let at = head * self.padded_dim() * block + channel * block;
                        let output = out.as_mut_ptr().wrapping_add(head * dim + channel);
                        let row = Row {
                            input: scores.as_ptr().wrapping_add(other * block),
                            input_step: pitch,
                            run: self.tokens_of(other).next_multiple_of(P::Weight::GROUP),
                            panel: values.as_ptr().wrapping_add(at),
                            vectors: self.value_vectors,
                            output,
                            residual: output,
                            output_step: d,
                            channels: (dim - channel).min(value_width),
                            scales: (),
                            ..row
                        };
                        // SAFETY: as above; a panel of values is `block` rows of `value_width`, a
                        // block is whole groups, and no channel beyond the head's is written. The
                        // residual is what the kernel itself wrote before.
                        unsafe { row.run(unit) };
                    }
                }
            });
        }
    }
}

vectorised! {
    /// `first` is the number of the first token within its frame.
    fn pack_rows<P: Product>(
        blocks: &TokenBlocks,
        first: usize,
        qkv: &[f32],
        rotary: &RotaryTable,
        queries: &mut [P::Input],
        keys: &mut [P::Weight],
        values: &mut [P::Weight],
    ) {
        let (d, dim, block) = (blocks.width(), blocks.dim, blocks.block);
        let group = <P::Weight as Element>::GROUP;
        let (key_width, value_width) = (blocks.key_vectors * LANES, blocks.value_vectors * LANES);
        let padded = blocks.padded_dim();
        let scale = 1.0 / (dim as f32).sqrt();
        let mut turned = vec![0.0_f32; dim];
        let rows = queries.chunks_exact_mut(d).zip(qkv.chunks_exact(3 * d));
        for (i, (query, qkv)) in rows.enumerate() {
            let (q, kv) = qkv.split_at(d);
            let (k, v) = kv.split_at(d);
            let angles = rotary.at(first + i);
            for (from, to) in q.chunks_exact(dim).zip(query.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles, &mut turned);
                for (to, value) in to.iter_mut().zip(&turned) {
                    *to = Element::from_f32(value * scale);
                }
            }
            for (from, keys) in k.chunks_exact(dim).zip(keys.chunks_exact_mut(dim * block)) {
                normalise_and_rotate(from, angles, &mut turned);
                let panel = &mut keys[i / key_width * key_width * dim..][..key_width * dim];
                // A key is a column: its channels lie side by side within a group only.
                let groups = panel.chunks_exact_mut(key_width * group);
                for (values, to) in turned.chunks_exact(group).zip(groups) {
                    for (to, value) in to[i % key_width * group..].iter_mut().zip(values) {
                        *to = Element::from_f32(*value);
                    }
                }
            }
            for (from, values) in v.chunks_exact(dim).zip(values.chunks_exact_mut(padded * block)) {
                let panels = values.chunks_exact_mut(block * value_width);
                for (from, panel) in from.chunks(value_width).zip(panels) {
                    // A value is a row: its channels are a group apart.
                    let row = &mut panel[i / group * group * value_width..][..group * value_width];
                    for (to, value) in row.chunks_exact_mut(group).zip(from) {
                        to[i % group] = Element::from_f32(*value);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::product::{Bf16, F32};
    use crate::ops::simd::Bf16Unit;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count)
            .map(|i| ((i * 7919 + seed) % 2003) as f32 / 1001.0 - 1.0)
            .collect()
    }

    /// What `blocks` make of `qkv` (tokens, 3 d), block by block.
    fn by_blocks<P: Product<Scales = ()>>(
        unit: P::Unit,
        blocks: &TokenBlocks,
        rotary: &RotaryTable,
        qkv: &[f32],
    ) -> Vec<f32>
    where
        P::Input: Float,
    {
        let d = blocks.width();
        let of_block = |i: usize| {
            let first = i * blocks.block() * 3 * d;
            let rows = &qkv[first..first + blocks.tokens_of(i) * 3 * d];
            let mut queries = vec![P::Input::ZERO; blocks.tokens_of(i) * d];
            let mut keys = vec![P::Weight::ZERO; blocks.key_values()];
            let mut values = vec![P::Weight::ZERO; blocks.value_values()];
            blocks.pack::<P>(i, rows, rotary, &mut queries, (&mut keys, &mut values));
            (queries, keys, values)
        };
        let packed: Vec<_> = (0..blocks.count()).map(of_block).collect();
        let mut scores = vec![f32::NAN; blocks.score_values()];
        let parts = packed.iter().map(|(queries, ..)| {
            let mut out = vec![f32::NAN; queries.len()];
            let of = |other: usize| (&*packed[other].1, &*packed[other].2);
            blocks.attend::<P>(unit, queries, of, &mut scores, &mut out);
            out
        });
        parts.collect::<Vec<_>>().concat()
    }

    /// The same in f64, but for the turning.
    fn by_definition(
        (tokens, heads, dim): (usize, usize, usize),
        rotary: &RotaryTable,
        qkv: &[f32],
    ) -> Vec<f64> {
        let d = heads * dim;
        let turned = |token: usize, from: usize| {
            let mut to = vec![0.0; dim];
            normalise_and_rotate(
                &qkv[token * 3 * d + from..][..dim],
                rotary.at(token),
                &mut to,
            );
            to
        };
        let mut out = vec![0.0; tokens * d];
        for head in 0..heads {
            for query in 0..tokens {
                let q = turned(query, head * dim);
                let weight = |key: usize| {
                    let k = turned(key, d + head * dim);
                    let products = q.iter().zip(k).map(|(q, k)| f64::from(*q) * f64::from(k));
                    (products.sum::<f64>() / (dim as f64).sqrt()).exp()
                };
                let weights: Vec<f64> = (0..tokens).map(weight).collect();
                let sum: f64 = weights.iter().sum();
                for (key, weight) in weights.iter().enumerate() {
                    let v = &qkv[key * 3 * d + 2 * d + head * dim..][..dim];
                    let out = &mut out[query * d + head * dim..][..dim];
                    for (out, v) in out.iter_mut().zip(v) {
                        *out += weight / sum * f64::from(*v);
                    }
                }
            }
        }
        out
    }

    #[test]
    fn attention_is_that_of_the_definition() {
        // Also of a token alone, of an odd number in the last block, and of channels that fill no panel.
        for (tokens, heads, dim) in [
            (1, 1, 16),
            (37, 2, 32),
            (128, 2, 64),
            (145, 1, 72),
            (40, 3, 48),
        ] {
            let blocks = TokenBlocks::new(tokens, heads, dim);
            let positions: Vec<usize> = (0..tokens).collect();
            let rotary = RotaryTable::sequence(&positions, dim);
            let qkv = numbers(tokens * 3 * heads * dim, 1);
            let expected = by_definition((tokens, heads, dim), &rotary, &qkv);
            let check = |what: &str, found: &[f32], tolerance: f64| {
                assert_eq!(found.len(), expected.len());
                for (found, expected) in found.iter().zip(&expected) {
                    let error = (f64::from(*found) - expected).abs();
                    assert!(
                        error < tolerance,
                        "{what}, {tokens} tokens, {heads} heads of {dim}: {error}"
                    );
                }
            };
            let set = InstructionSet::detect();
            check("f32", &by_blocks::<F32>(set, &blocks, &rotary, &qkv), 1e-5);
            let units = Bf16Unit::ALL.iter().copied();
            for unit in units.filter(|unit| unit.can_be_tested()) {
                let found = by_blocks::<Bf16>(unit, &blocks, &rotary, &qkv);
                check(unit.name(), &found, 1e-2);
            }
        }
    }
}
