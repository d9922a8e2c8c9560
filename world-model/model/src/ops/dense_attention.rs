//! Attention of all queries to all keys of a sequence, for inference: scores and weighted sums by
//! the kernel of matrix products, a block of queries at a time, so that scores stay in cache.

use std::mem::MaybeUninit;

use half::bf16;
use rayon::prelude::*;

use super::panel_product::{PanelProduct, Rows};
use super::panels::Panels;
use super::softmax::softmax_rows;
use super::uncleared::uncleared;
use crate::NumberFormat;

/// Queries that one task handles at most.
const QUERIES: usize = 64;

/// Sizes of an attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttentionShape {
    /// Entries of the batch.
    pub batch: usize,
    /// Heads of each.
    pub heads: usize,
    /// Queries of each head.
    pub queries: usize,
    /// Keys of each head.
    pub keys: usize,
    /// Channels of a head.
    pub dim: usize,
}

/// What is added to the scores before the softmax: 0 where a query sees a key, -inf where not.
#[derive(Clone, Copy, Debug)]
pub struct ScoreMask<'a> {
    /// (entries, heads, queries, keys), the first three as in `sizes`.
    pub values: &'a [f32],
    /// Batch entries, heads and queries; each is that of the attention, or 1 where the same values
    /// serve all.
    pub sizes: [usize; 3],
}

impl<'a> ScoreMask<'a> {
    /// # Panics
    /// If the mask does not fit the shape.
    fn check(&self, shape: &AttentionShape) {
        let whole = [shape.batch, shape.heads, shape.queries];
        let fits = self
            .sizes
            .iter()
            .zip(whole)
            .all(|(size, of)| *size == 1 || *size == of);
        let count: usize = self.sizes.iter().product::<usize>() * shape.keys;
        assert!(fits && self.values.len() == count, "mask");
    }

    /// The values for one query: a value a key.
    fn row(&self, entry: usize, head: usize, query: usize, keys: usize) -> &'a [f32] {
        let [_, heads, queries] = self.sizes;
        let at = |index: usize, size: usize| if size == 1 { 0 } else { index };
        let [entry, head, query] = [
            at(entry, self.sizes[0]),
            at(head, heads),
            at(query, queries),
        ];
        let start = ((entry * heads + head) * queries + query) * keys;
        self.values.get(start..start + keys).unwrap_or_default()
    }
}

/// Queries, keys or values as they lie in memory: each a run of the head's channels.
#[derive(Clone, Copy, Debug)]
pub struct HeadRows<'a> {
    /// From the first channel of the first row of the first head on.
    pub values: &'a [f32],
    /// From one batch entry, head and row to the next.
    pub steps: [usize; 3],
}

impl<'a> HeadRows<'a> {
    /// Of (batch, heads, rows, dim).
    pub fn contiguous(values: &'a [f32], heads: usize, rows: usize, dim: usize) -> Self {
        Self {
            values,
            steps: [heads * rows * dim, rows * dim, dim],
        }
    }

    /// # Panics
    /// If the values are fewer than `sizes` (batch, heads, rows) and `dim` need.
    fn check(&self, sizes: [usize; 3], dim: usize, what: &str) {
        let of_all = sizes.iter().zip(self.steps);
        let last: usize = of_all
            .map(|(size, step)| size.saturating_sub(1) * step)
            .sum();
        let is_empty = sizes.contains(&0) || dim == 0;
        assert!(is_empty || last + dim <= self.values.len(), "{what}");
    }

    /// The channels of a row.
    fn row(&self, entry: usize, head: usize, row: usize, dim: usize) -> &'a [f32] {
        let values = self.from(entry, head, row);
        values.get(..dim).unwrap_or_default()
    }

    /// From the first channel of a row on.
    fn from(&self, entry: usize, head: usize, row: usize) -> &'a [f32] {
        let [entries, heads, rows] = self.steps;
        let at = entry * entries + head * heads + row * rows;
        self.values.get(at..).unwrap_or_default()
    }
}

/// softmax(scale q k^T + mask) v for `q` (batch, heads, queries, dim), `k` and `v` (batch, heads, keys, dim): (batch,
/// queries, heads, dim). Where `format` is not f32 and the processor has products of bf16, the factors of both
/// products are rounded to it.
///
/// # Panics
/// If a slice has another size, or the number of outputs overflows.
pub fn dense_attention(
    shape: AttentionShape,
    qkv: [HeadRows<'_>; 3],
    scale: f32,
    mask: Option<ScoreMask<'_>>,
    format: NumberFormat,
) -> Vec<f32> {
    match format.bf16_unit() {
        Some(_) => attend::<bf16>(shape, qkv, scale, mask),
        None => attend::<f32>(shape, qkv, scale, mask),
    }
}

fn attend<T: PanelProduct>(
    shape: AttentionShape,
    [q, k, v]: [HeadRows<'_>; 3],
    scale: f32,
    mask: Option<ScoreMask<'_>>,
) -> Vec<f32> {
    let AttentionShape {
        batch,
        heads,
        queries,
        keys,
        dim,
    } = shape;
    q.check([batch, heads, queries], dim, "queries");
    k.check([batch, heads, keys], dim, "keys");
    v.check([batch, heads, keys], dim, "values");
    if let Some(mask) = &mask {
        mask.check(&shape);
    }
    let length = [batch, queries, heads, dim]
        .into_iter()
        .try_fold(1_usize, usize::checked_mul);
    assert!(length.is_some(), "size of an attention: {shape:?}");
    let (width, length) = (heads * dim, length.unwrap_or(0));
    if keys == 0 || width == 0 || queries == 0 {
        return vec![0.0; length];
    }
    let packed = (0..batch * heads).into_par_iter().map(|number| {
        let (entry, head) = (number / heads, number % heads);
        let across = Panels::pack_columns(dim, keys, scale, |key| k.row(entry, head, key, dim));
        let along = Panels::pack_plain_rows(keys, dim, |key| v.row(entry, head, key, dim));
        (across, along)
    });
    let packed: Vec<(Panels<T>, Panels<T>)> = packed.collect();
    // An even number of equal blocks: with one of a few queries more than the others a thread would be idle.
    let blocks = match queries.div_ceil(QUERIES) {
        1 => 1,
        blocks => blocks.next_multiple_of(2),
    };
    let block = queries.div_ceil(blocks);
    let write_entry = |(entry, (out, packed)): (usize, (&mut [MaybeUninit<f32>], &[_]))| {
        let blocks = out.par_chunks_mut(block * width).enumerate();
        blocks.for_each_init(Vec::new, |scores: &mut Vec<f32>, (number, out)| {
            let (first, count) = (number * block, out.len() / width);
            scores.resize(count * keys, 0.0);
            for (head, (across, along)) in packed.iter().enumerate() {
                let rows = |values, step| Rows {
                    values,
                    step,
                    count,
                };
                let [_, _, step] = q.steps;
                let target = Rows {
                    values: scores.as_mut_slice(),
                    step: keys,
                    count,
                };
                T::product_of_rows(across, rows(q.from(entry, head, first), step), target);
                if let Some(mask) = &mask {
                    for (row, scores) in scores.chunks_exact_mut(keys).enumerate() {
                        let mask = mask.row(entry, head, first + row, keys);
                        for (score, mask) in scores.iter_mut().zip(mask) {
                            *score += mask;
                        }
                    }
                }
                softmax_rows(scores, keys, keys);
                let target = Rows {
                    values: out.get_mut(head * dim..).unwrap_or_default(),
                    step: width,
                    count,
                };
                T::product_of_rows(along, rows(scores.as_slice(), keys), target);
            }
        });
    };
    let write = |out: &mut [MaybeUninit<f32>]| {
        let entries = out.par_chunks_mut(queries * width);
        let entries = entries.zip(packed.par_chunks(heads)).enumerate();
        entries.for_each(write_entry);
    };
    // SAFETY: the blocks of all entries cover all values in whole rows, for the length is that of the shape. In each row, the
    // second product of each head writes that head's channels (`PanelProduct::product_of_rows`).
    unsafe { uncleared(length, write) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: usize) -> Vec<f32> {
        (0..count)
            .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
            .collect()
    }

    #[test]
    fn attention_is_that_of_the_definition() {
        let (batch, heads) = (2, 3);
        for (queries, keys, dim, sizes) in [
            (5, 7, 12, Some([batch, heads, 5])),
            (70, 33, 16, None),
            (64, 64, 72, Some([batch, 1, 1])),
            (70, 7, 16, Some([1, 1, 70])),
            (5, 7, 12, Some([1, heads, 1])),
        ] {
            let shape = AttentionShape {
                batch,
                heads,
                queries,
                keys,
                dim,
            };
            let all = batch * heads;
            let q = numbers(all * queries * dim, 1);
            let (k, v) = (numbers(all * keys * dim, 2), numbers(all * keys * dim, 3));
            let count = sizes.map_or(0, |sizes| sizes.iter().product::<usize>() * keys);
            let values: Vec<f32> = (0..count)
                .map(|i| if i % 3 == 1 { f32::NEG_INFINITY } else { 0.0 })
                .collect();
            let mask = sizes.map(|sizes| ScoreMask {
                values: &values,
                sizes,
            });
            let added = |row: usize, key: usize| {
                let [entries, of_heads, of_queries] = sizes.unwrap_or([1; 3]);
                let entry = row / (queries * heads) % entries;
                let (head, query) = (row / queries % heads % of_heads, row % queries % of_queries);
                values
                    .get(((entry * of_heads + head) * of_queries + query) * keys + key)
                    .copied()
                    .unwrap_or_default()
            };
            let of = |values, rows| HeadRows::contiguous(values, heads, rows, dim);
            let qkv = [of(&q, queries), of(&k, keys), of(&v, keys)];
            for (format, tolerance) in [(NumberFormat::F32, 1e-5), (NumberFormat::Bf16, 1e-2)] {
                let found = dense_attention(shape, qkv, 0.3, mask, format);
                for (number, found) in found.chunks_exact(dim).enumerate() {
                    let (entry, query, head) = (
                        number / heads / queries,
                        number / heads % queries,
                        number % heads,
                    );
                    let head = entry * heads + head;
                    let row = head * queries + query;
                    let key = |values: &[f32], key: usize, c: usize| {
                        values[(head * keys + key) * dim + c]
                    };
                    let weights: Vec<f32> = (0..keys)
                        .map(|j| {
                            let dot: f32 = (0..dim).map(|c| q[row * dim + c] * key(&k, j, c)).sum();
                            (0.3 * dot + added(row, j)).exp()
                        })
                        .collect();
                    let sum: f32 = weights.iter().sum();
                    for (c, found) in found.iter().enumerate() {
                        let expected: f32 = (0..keys).map(|j| weights[j] * key(&v, j, c)).sum();
                        let error = (expected / sum - found).abs();
                        assert!(error < tolerance, "{shape:?} {sizes:?} {format:?}: {error}");
                    }
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "mask")]
    fn a_mask_of_another_size_is_refused() {
        let shape = AttentionShape {
            batch: 2,
            heads: 3,
            queries: 1,
            keys: 4,
            dim: 8,
        };
        let (q, k) = (numbers(6 * 8, 1), numbers(6 * 4 * 8, 2));
        let mask = ScoreMask {
            values: &[0.0; 12],
            sizes: [3, 1, 1],
        };
        let (q, k) = (
            HeadRows::contiguous(&q, 3, 1, 8),
            HeadRows::contiguous(&k, 3, 4, 8),
        );
        dense_attention(shape, [q, k, k], 1.0, Some(mask), NumberFormat::F32);
    }
}
