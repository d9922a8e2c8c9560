//! Attention of all queries to all keys of a sequence, for inference: scores and weighted sums by
//! the kernel of matrix products, a block of queries at a time, so that scores stay in cache.

use rayon::prelude::*;

use super::packed_linear::product;
use super::panels::Panels;
use super::softmax::softmax_rows;

/// Queries that one task handles.
const QUERIES: usize = 64;

/// Sizes of an attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AttentionShape {
    /// Sequences times heads: attentions that have nothing to do with each other.
    pub heads: usize,
    /// Queries of each.
    pub queries: usize,
    /// Keys of each.
    pub keys: usize,
    /// Channels of a head.
    pub dim: usize,
}

/// softmax(scale q k^T + mask) v for `q` (heads, queries, dim), `k` and `v` (heads, keys, dim):
/// (heads, queries, dim). `mask` (heads, queries, keys) is added to the scores.
///
/// # Panics
/// If a slice has another size.
pub fn dense_attention(
    shape: AttentionShape,
    (q, k, v): (&[f32], &[f32], &[f32]),
    scale: f32,
    mask: Option<&[f32]>,
) -> Vec<f32> {
    let AttentionShape {
        heads,
        queries,
        keys,
        dim,
    } = shape;
    // The kernel trusts these.
    assert_eq!(q.len(), heads * queries * dim, "queries");
    assert_eq!(k.len(), heads * keys * dim, "keys");
    assert_eq!(v.len(), heads * keys * dim, "values");
    assert!(
        mask.is_none_or(|m| m.len() == heads * queries * keys),
        "mask"
    );
    let mut out = vec![0.0; q.len()];
    if keys == 0 || dim == 0 || queries == 0 {
        return out;
    }
    out.par_chunks_exact_mut(queries * dim)
        .enumerate()
        .for_each(|(head, out)| {
            let part = |values: &'_ [f32], at: usize| values.get(at).copied().unwrap_or_default();
            let first = head * keys * dim;
            let across: Panels = Panels::pack(dim, keys, None, |c, key| {
                part(k, first + key * dim + c) * scale
            });
            let along: Panels =
                Panels::pack(keys, dim, None, |key, c| part(v, first + key * dim + c));
            out.par_chunks_mut(QUERIES * dim).enumerate().for_each_init(
                Vec::new,
                |scores: &mut Vec<f32>, (block, out)| {
                    let rows = out.len() / dim;
                    let start = head * queries + block * QUERIES;
                    scores.resize(rows * keys, 0.0);
                    if let Some(q) = q.get(start * dim..(start + rows) * dim) {
                        product(&across, q, scores);
                    }
                    let mask = mask.and_then(|mask| mask.get(start * keys..(start + rows) * keys));
                    for (score, mask) in scores.iter_mut().zip(mask.into_iter().flatten()) {
                        *score += mask;
                    }
                    softmax_rows(scores, keys, keys);
                    product(&along, scores, out);
                },
            );
        });
    out
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
        for (queries, keys, dim, masked) in
            [(5, 7, 12, true), (70, 33, 16, false), (64, 64, 72, true)]
        {
            let shape = AttentionShape {
                heads: 3,
                queries,
                keys,
                dim,
            };
            let q = numbers(3 * queries * dim, 1);
            let (k, v) = (numbers(3 * keys * dim, 2), numbers(3 * keys * dim, 3));
            let mask: Vec<f32> = (0..3 * queries * keys)
                .map(|i| if i % 3 == 1 { f32::NEG_INFINITY } else { 0.0 })
                .collect();
            let mask = masked.then_some(mask.as_slice());
            let found = dense_attention(shape, (&q, &k, &v), 0.3, mask);
            for (row, found) in found.chunks_exact(dim).enumerate() {
                let head = row / queries;
                let key =
                    |values: &[f32], key: usize, c: usize| values[(head * keys + key) * dim + c];
                let weights: Vec<f32> = (0..keys)
                    .map(|j| {
                        let dot: f32 = (0..dim).map(|c| q[row * dim + c] * key(&k, j, c)).sum();
                        (0.3 * dot + mask.map_or(0.0, |m| m[row * keys + j])).exp()
                    })
                    .collect();
                let sum: f32 = weights.iter().sum();
                for (c, found) in found.iter().enumerate() {
                    let expected: f32 = (0..keys).map(|j| weights[j] * key(&v, j, c)).sum();
                    assert!((expected / sum - found).abs() < 1e-5, "{shape:?}");
                }
            }
        }
    }
}
