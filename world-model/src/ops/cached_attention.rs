//! Temporal attention of one new frame over the keys and values of earlier frames; for inference,
//! so without gradient.

use candle_core::{Result, Tensor};
use rayon::prelude::*;

use super::exponential::exp;
use super::host::host;
use super::rotary::{RotaryTable, normalise_and_rotate};
use super::vectorised::vectorised;

/// Tokens that one task handles.
const ROWS: usize = 16;

/// Keys and values of one frame for the temporal attention of one block.
///
/// Keys are stored as the scores need them: normalised, turned by the frame's position, and with
/// their channels in the order of the kernels.
#[derive(Clone, Debug)]
pub struct FrameKeys {
    /// (B or 1, N, d).
    keys: Tensor,
    /// (B or 1, N, d).
    values: Tensor,
}

impl FrameKeys {
    /// Number of candidates that they were computed for.
    pub fn batch(&self) -> usize {
        self.keys.dim(0).unwrap_or(1)
    }
}

/// Attends from a new frame to earlier frames and to itself.
///
/// `qkv` is (B, N, 3 d); each earlier frame has a batch of B, or of 1, which is then shared.
/// `angles` has the new frame's position only. Gives (B, N, d) and the new frame's own keys and
/// values.
///
/// # Errors
/// If the shapes do not fit.
pub fn cached_attention(
    qkv: &Tensor,
    earlier: &[&FrameKeys],
    heads: usize,
    angles: &RotaryTable,
) -> Result<(Tensor, FrameKeys)> {
    let (b, n, width) = qkv.dims3()?;
    let (d, dim) = (width / 3, angles.head_dim());
    if width != 3 * heads * dim || angles.len() != 1 {
        candle_core::bail!(
            "cached_attention: {:?} for {heads} heads of {dim} channels at {} positions",
            qkv.shape(),
            angles.len()
        );
    }
    let qkv = qkv.contiguous()?;
    let guard = host(&qkv);
    let qkv_values = guard.values()?;
    let (queries, keys, values) = split(qkv_values, d, angles);

    let mut sources = Vec::with_capacity(earlier.len() + 1);
    let hosts: Vec<_> = earlier
        .iter()
        .map(|frame| (host(&frame.keys), host(&frame.values), frame.keys.dim(0)))
        .collect();
    for (k, v, batch) in &hosts {
        let (k, v) = (k.values()?, v.values()?);
        let shared = match batch {
            Ok(1) => true,
            Ok(batch) if *batch == b => false,
            _ => candle_core::bail!("cached_attention: cached frames of another batch than {b}"),
        };
        if k.len() != n * d * if shared { 1 } else { b } || v.len() != k.len() {
            candle_core::bail!("cached_attention: cached frames of another size than {n} x {d}");
        }
        sources.push((k, v, shared));
    }
    sources.push((&keys, &values, false));

    let mut out = vec![0.0; b * n * d];
    let scale = 1.0 / (dim as f32).sqrt();
    out.par_chunks_mut(ROWS * d)
        .zip(queries.par_chunks(ROWS * d))
        .enumerate()
        .for_each_init(
            || vec![0.0; sources.len()],
            |weights, (chunk, (out, queries))| {
                let rows = Rows {
                    first: chunk * ROWS,
                    n,
                    d,
                    dim,
                    scale,
                };
                attend_rows(out, queries, &sources, weights, rows);
            },
        );
    drop(sources);
    let tensor = |values: Vec<f32>| Tensor::from_vec(values, (b, n, d), qkv.device());
    let frame = FrameKeys {
        keys: tensor(keys)?,
        values: tensor(values)?,
    };
    Ok((tensor(out)?, frame))
}

/// Queries and keys, normalised and turned, and values, of rows q | k | v.
fn split(qkv: &[f32], d: usize, angles: &RotaryTable) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let size = qkv.len() / 3;
    let (mut queries, mut keys, mut values) = (vec![0.0; size], vec![0.0; size], vec![0.0; size]);
    queries
        .par_chunks_mut(ROWS * d)
        .zip(keys.par_chunks_mut(ROWS * d))
        .zip(values.par_chunks_mut(ROWS * d))
        .zip(qkv.par_chunks(ROWS * 3 * d))
        .for_each(|(((queries, keys), values), qkv)| {
            split_rows(queries, keys, values, qkv, d, angles);
        });
    (queries, keys, values)
}

/// Keys, values, and whether they are shared by the whole batch, of one frame.
type Source<'a> = (&'a [f32], &'a [f32], bool);

/// Which rows of the new frames a task handles.
#[derive(Clone, Copy)]
struct Rows {
    /// Number of the first, over the whole batch.
    first: usize,
    /// Tokens of a frame.
    n: usize,
    d: usize,
    /// Channels of a head.
    dim: usize,
    scale: f32,
}

vectorised! {
    fn attend_rows(
        out: &mut [f32],
        queries: &[f32],
        sources: &[Source<'_>],
        weights: &mut [f32],
        rows: Rows,
    ) {
        let Rows { first, n, d, dim, scale } = rows;
        let pairs = out.chunks_exact_mut(d).zip(queries.chunks_exact(d));
        for (row, (out, query)) in (first..).zip(pairs) {
            let heads = out.chunks_exact_mut(dim).zip(query.chunks_exact(dim));
            for (head, (out, query)) in heads.enumerate() {
                let (own, common) = (row * d + head * dim, row % n * d + head * dim);
                for (weight, (k, _, shared)) in weights.iter_mut().zip(sources) {
                    let start = if *shared { common } else { own };
                    *weight = dot(query, &k[start..][..dim]) * scale;
                }
                softmax(weights);
                for (weight, (_, v, shared)) in weights.iter().zip(sources) {
                    let start = if *shared { common } else { own };
                    for (out, v) in out.iter_mut().zip(&v[start..][..dim]) {
                        *out = weight.mul_add(*v, *out);
                    }
                }
            }
        }
    }
}

vectorised! {
    fn split_rows(
        queries: &mut [f32],
        keys: &mut [f32],
        values: &mut [f32],
        qkv: &[f32],
        d: usize,
        angles: &RotaryTable,
    ) {
        let dim = angles.head_dim();
        let rows = queries.chunks_exact_mut(d).zip(keys.chunks_exact_mut(d));
        let rows = rows.zip(values.chunks_exact_mut(d)).zip(qkv.chunks_exact(3 * d));
        for (((queries, keys), values), qkv) in rows {
            let (q, kv) = qkv.split_at(d);
            let (k, v) = kv.split_at(d);
            for (from, to) in q.chunks_exact(dim).zip(queries.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles.at(0), to);
            }
            for (from, to) in k.chunks_exact(dim).zip(keys.chunks_exact_mut(dim)) {
                normalise_and_rotate(from, angles.at(0), to);
            }
            values.copy_from_slice(v);
        }
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 16];
    for (a, b) in a.as_chunks::<16>().0.iter().zip(b.as_chunks::<16>().0) {
        for lane in 0..16 {
            sums[lane] = a[lane].mul_add(b[lane], sums[lane]);
        }
    }
    sums.iter().sum()
}

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
