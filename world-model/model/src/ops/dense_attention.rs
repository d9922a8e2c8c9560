//! Attention of all queries to all keys of a sequence, for inference: scores and weighted sums by
//! the kernel of matrix products, a block of queries at a time, so that scores stay in cache.

use rayon::prelude::*;

use super::panel_product::PanelProduct;
use super::panels::Panels;
use super::softmax::softmax_rows;

/// Queries that one task handles.
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

/// softmax(scale q k^T + mask) v for `q` (batch, heads, queries, dim), `k` and `v` (batch, heads,
/// keys, dim): (batch, heads, queries, dim).
///
/// # Panics
/// If a slice has another size.
pub fn dense_attention(
    shape: AttentionShape,
    (q, k, v): (&[f32], &[f32], &[f32]),
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
    // The kernel trusts these.
    assert_eq!(q.len(), batch * heads * queries * dim, "queries");
    assert_eq!(k.len(), batch * heads * keys * dim, "keys");
    assert_eq!(v.len(), batch * heads * keys * dim, "values");
    if let Some(mask) = &mask {
        mask.check(&shape);
    }
    let mut out = vec![0.0; q.len()];
    if keys == 0 || dim == 0 || queries == 0 {
        return out;
    }
    out.par_chunks_exact_mut(queries * dim)
        .enumerate()
        .for_each(|(number, out)| {
            let (entry, head) = (number / heads, number % heads);
            let part = |values: &'_ [f32], at: usize| values.get(at).copied().unwrap_or_default();
            let first = number * keys * dim;
            let across: Panels = Panels::pack_rows(dim, keys, None, |c, key, row| {
                for (key, value) in (key..).zip(row) {
                    *value = part(k, first + key * dim + c) * scale;
                }
            });
            let along: Panels = Panels::pack_rows(keys, dim, None, |key, c, row| {
                let from = first + key * dim + c;
                if let Some(values) = v.get(from..from + row.len()) {
                    row.copy_from_slice(values);
                }
            });
            out.par_chunks_mut(QUERIES * dim).enumerate().for_each_init(
                Vec::new,
                |scores: &mut Vec<f32>, (block, out)| {
                    let rows = out.len() / dim;
                    let start = number * queries + block * QUERIES;
                    scores.resize(rows * keys, 0.0);
                    if let Some(q) = q.get(start * dim..(start + rows) * dim) {
                        f32::product(&across, q, scores);
                    }
                    if let Some(mask) = &mask {
                        for (row, scores) in scores.chunks_exact_mut(keys).enumerate() {
                            let mask = mask.row(entry, head, block * QUERIES + row, keys);
                            for (score, mask) in scores.iter_mut().zip(mask) {
                                *score += mask;
                            }
                        }
                    }
                    softmax_rows(scores, keys, keys);
                    f32::product(&along, scores, out);
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
            let found = dense_attention(shape, (&q, &k, &v), 0.3, mask);
            for (row, found) in found.chunks_exact(dim).enumerate() {
                let head = row / queries;
                let key =
                    |values: &[f32], key: usize, c: usize| values[(head * keys + key) * dim + c];
                let weights: Vec<f32> = (0..keys)
                    .map(|j| {
                        let dot: f32 = (0..dim).map(|c| q[row * dim + c] * key(&k, j, c)).sum();
                        (0.3 * dot + added(row, j)).exp()
                    })
                    .collect();
                let sum: f32 = weights.iter().sum();
                for (c, found) in found.iter().enumerate() {
                    let expected: f32 = (0..keys).map(|j| weights[j] * key(&v, j, c)).sum();
                    assert!((expected / sum - found).abs() < 1e-5, "{shape:?} {sizes:?}");
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
        dense_attention(shape, (&q, &k, &k), 1.0, Some(mask));
    }
}
