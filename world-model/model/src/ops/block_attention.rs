//! Attention within a frame for inference: the frame's tokens are cut into blocks, each block's
//! keys and values are packed for the kernel of matrix products, and a block of queries attends to
//! all of them.
//!
//! Blocks are what threads share: each projects its own tokens, and then reads the keys and values
//! of all. The cut depends on the number of tokens only, so results do not depend on the threads.

use super::kernel::Row;
use super::product::F32;
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
    /// Vectors in a panel of keys.
    vectors: usize,
    set: InstructionSet,
}

/// Packed keys and values of one block of tokens.
pub(crate) type Packed<'a> = (&'a [f32], &'a [f32]);

impl TokenBlocks {
    /// For frames of `tokens` tokens, `heads` heads of `dim` channels.
    pub(crate) fn new(tokens: usize, heads: usize, dim: usize) -> Self {
        let set = InstructionSet::detect();
        // Two blocks at least, for two threads, where they are of a useful size.
        let block = tokens
            .div_ceil(2)
            .next_multiple_of(LANES)
            .clamp(LANES, MOST_TOKENS);
        let vectors = [4, 2, 1]
            .into_iter()
            .find(|v| *v <= set.tile_vectors() && (block / LANES).is_multiple_of(*v))
            .unwrap_or(1);
        Self {
            tokens,
            block,
            heads,
            dim,
            vectors,
            set,
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

    /// Values of a block's packed keys.
    pub(crate) fn key_values(&self) -> usize {
        self.heads * self.dim * self.block
    }

    /// Values of a block's packed values.
    pub(crate) fn value_values(&self) -> usize {
        self.heads * self.dim.next_multiple_of(LANES) * self.block
    }

    /// Values of the scratch that [`Self::attend`] needs.
    pub(crate) fn score_values(&self) -> usize {
        self.block * self.count() * self.block
    }

    /// Takes apart the rows `qkv` (n, 3 d) of block `i`: queries (n, d), normalised, turned and
    /// scaled, and packed keys and values.
    pub(crate) fn pack(
        &self,
        i: usize,
        qkv: &[f32],
        rotary: &RotaryTable,
        queries: &mut [f32],
        (keys, values): (&mut [f32], &mut [f32]),
    ) {
        pack_rows(self, i * self.block, qkv, rotary, queries, keys, values);
    }

    /// Attention of `queries` (n, d) to the tokens of all blocks, to `out` (n, d).
    ///
    /// # Panics
    /// If a slice has another size.
    pub(crate) fn attend<'a>(
        &self,
        queries: &[f32],
        packed: impl Fn(usize) -> Packed<'a>,
        scores: &mut [f32],
        out: &mut [f32],
    ) {
        let (d, dim, block) = (self.width(), self.dim, self.block);
        let rows = queries.len() / d.max(1);
        let pitch = self.count() * block;
        // The kernel trusts these.
        assert!(rows <= block && out.len() == rows * d && queries.len() == rows * d);
        assert!(scores.len() >= rows * pitch, "scratch for scores");
        out.fill(0.0);
        let panels = dim.div_ceil(LANES);
        let width = self.vectors * LANES;
        let kernel = |run: usize, vectors: usize| Row::<F32> {
            input: queries.as_ptr(),
            input_step: d,
            tap_pitch: 0,
            tap_rows: 1,
            run,
            panel: std::ptr::null(),
            vectors,
            bias: NO_BIAS.as_ptr(),
            scales: (),
            pixels: rows,
            output: std::ptr::null_mut(),
            residual: std::ptr::null(),
            mask: std::ptr::null(),
            output_step: pitch,
            channels: vectors * LANES,
            relu: false,
        };
        for head in 0..self.heads {
            for other in 0..self.count() {
                let (keys, _) = packed(other);
                assert_eq!(keys.len(), self.key_values(), "packed keys");
                for column in (0..block).step_by(width) {
                    let row = Row {
                        input: queries.as_ptr().wrapping_add(head * dim),
                        panel: keys
                            .as_ptr()
                            .wrapping_add(head * dim * block + column * dim),
                        output: scores.as_mut_ptr().wrapping_add(other * block + column),
                        ..kernel(dim, self.vectors)
                    };
                    // SAFETY: the lengths were checked above; a head's keys are `dim * block`
                    // values, of which a panel takes `dim * width`, and `width` divides `block`.
                    unsafe { row.run(self.set) };
                }
            }
            if let Some(scores) = scores.get_mut(..rows * pitch) {
                softmax_rows(scores, pitch, self.tokens);
            }
            for other in 0..self.count() {
                let (_, values) = packed(other);
                assert_eq!(values.len(), self.value_values(), "packed values");
                for panel in 0..panels {
                    let at = (head * panels + panel) * block * LANES;
                    let output = out.as_mut_ptr().wrapping_add(head * dim + panel * LANES);
                    let row = Row {
                        input: scores.as_ptr().wrapping_add(other * block),
                        input_step: pitch,
                        panel: values.as_ptr().wrapping_add(at),
                        output,
                        residual: output,
                        output_step: d,
                        channels: (dim - panel * LANES).min(LANES),
                        ..kernel(self.tokens_of(other), 1)
                    };
                    // SAFETY: as above; a panel of values is `block` rows of `LANES`, and no
                    // channel beyond the head's is written. The residual is what the kernel
                    // itself wrote before.
                    unsafe { row.run(self.set) };
                }
            }
        }
    }
}

vectorised! {
    /// `first` is the number of the first token within its frame.
    fn pack_rows(
        blocks: &TokenBlocks,
        first: usize,
        qkv: &[f32],
        rotary: &RotaryTable,
        queries: &mut [f32],
        keys: &mut [f32],
        values: &mut [f32],
    ) {
        let (d, dim, block) = (blocks.width(), blocks.dim, blocks.block);
        let width = blocks.vectors * LANES;
        let scale = 1.0 / (dim as f32).sqrt();
        let mut turned = vec![0.0_f32; dim];
        let rows = queries.chunks_exact_mut(d).zip(qkv.chunks_exact(3 * d));
        for (i, (query, qkv)) in rows.enumerate() {
            let (q, kv) = qkv.split_at(d);
            let (k, v) = kv.split_at(d);
            let angles = rotary.at(first + i);
            for (from, to) in q.chunks_exact(dim).zip(query.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles, to);
                for value in to {
                    *value *= scale;
                }
            }
            for (from, keys) in k.chunks_exact(dim).zip(keys.chunks_exact_mut(dim * block)) {
                normalise_and_rotate(from, angles, &mut turned);
                let panel = &mut keys[i / width * width * dim..][..width * dim];
                for (value, row) in turned.iter().zip(panel.chunks_exact_mut(width)) {
                    row[i % width] = *value;
                }
            }
            let padded = dim.next_multiple_of(LANES);
            for (from, values) in v.chunks_exact(dim).zip(values.chunks_exact_mut(padded * block)) {
                for (from, panel) in from.chunks(LANES).zip(values.chunks_exact_mut(block * LANES)) {
                    panel[i * LANES..][..from.len()].copy_from_slice(from);
                }
            }
        }
    }
}
