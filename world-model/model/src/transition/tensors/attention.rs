//! Attention of queries, keys and values that one product gave.

use candle_core::{D, DType, Tensor};

use super::context::{EarlierLayer, KeysValues};
use crate::Result;
use crate::ops::normalise_and_rotate_plain;

/// Cosines and sines, (positions, pairs) each.
pub(super) type Angles = (Tensor, Tensor);

/// The attention's heads.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heads {
    pub(super) count: usize,
    pub(super) dim: usize,
}

/// Queries, keys or values.
const QUERIES: usize = 0;
const KEYS: usize = 1;
const VALUES: usize = 2;

impl Heads {
    /// Part `part` of `qkv` (B, F, N, 3 d): (B, F, N, heads, dim).
    fn part(self, qkv: &Tensor, part: usize) -> Result<Tensor> {
        let (b, f, n, _) = qkv.dims4()?;
        let width = self.count * self.dim;
        let part = qkv.narrow(D::Minus1, part * width, width)?;
        Ok(part.reshape((b, f, n, self.count, self.dim))?)
    }

    /// Normalised and turned, for `x` (.., positions, dim).
    fn turned(x: &Tensor, angles: &Angles) -> Result<Tensor> {
        Ok(normalise_and_rotate_plain(
            &x.to_dtype(DType::F32)?,
            angles,
        )?)
    }

    /// Queries are scaled before they are rounded, so that scores need not be.
    fn queries(self, x: &Tensor, angles: &Angles) -> Result<Tensor> {
        let scaled = (Self::turned(x, angles)? / (self.dim as f64).sqrt())?;
        Ok(scaled.to_dtype(x.dtype())?)
    }

    fn keys(x: &Tensor, angles: &Angles) -> Result<Tensor> {
        Ok(Self::turned(x, angles)?.to_dtype(x.dtype())?)
    }

    /// Within every frame, of `qkv` (B, F, N, 3 d) for tokens with these angles: (B, F, N, d).
    pub(super) fn attend_in_space(self, qkv: &Tensor, angles: &Angles) -> Result<Tensor> {
        let (b, f, n, _) = qkv.dims4()?;
        let part = |part: usize| -> Result<Tensor> {
            let part = self.part(qkv, part)?;
            Ok(part.permute((0, 1, 3, 2, 4))?.contiguous()?)
        };
        let queries = self.queries(&part(QUERIES)?, angles)?;
        let keys = Self::keys(&part(KEYS)?, angles)?;
        let weights = softmax(&scores(&queries, &keys)?)?;
        let attended = weighted(&weights, &part(VALUES)?)?;
        let attended = attended.permute((0, 1, 3, 2, 4))?;
        Ok(attended.reshape((b, f, n, self.count * self.dim))?)
    }

    /// Over time, of `qkv` (B, F, N, 3 d) of frames with these angles, each of which sees itself, those before it, and
    /// all `earlier` ones: (B, F, N, d), and the frames' own keys and values.
    pub(super) fn attend_in_time(
        self,
        qkv: &Tensor,
        angles: &Angles,
        earlier: &EarlierLayer,
    ) -> Result<(Tensor, KeysValues)> {
        let (b, f, n, _) = qkv.dims4()?;
        let part = |part: usize| -> Result<Tensor> {
            let part = self.part(qkv, part)?;
            Ok(part.permute((0, 2, 3, 1, 4))?.contiguous()?)
        };
        let queries = self.queries(&part(QUERIES)?, angles)?;
        let new = KeysValues {
            keys: Self::keys(&part(KEYS)?, angles)?,
            values: part(VALUES)?,
        };
        let own = new.after(earlier.own.as_ref())?;
        let mut of_own = scores(&queries, &own.keys)?;
        if f > 1 {
            of_own = of_own.broadcast_add(&causal(f, &of_own)?)?;
        }
        let attended = match &earlier.shared {
            None => weighted(&softmax(&of_own)?, &own.values)?,
            Some(shared) => {
                // Of all candidates together, so that what they share is read once: (N, heads, B F, ..).
                let together = |x: &Tensor| -> Result<Tensor> {
                    let last = x.dim(D::Minus1)?;
                    let x = x.permute((1, 2, 0, 3, 4))?;
                    Ok(x.reshape((n, self.count, b * f, last))?)
                };
                let apart = |x: &Tensor| -> Result<Tensor> {
                    let last = x.dim(D::Minus1)?;
                    let x = x.reshape((n, self.count, b, f, last))?;
                    Ok(x.permute((2, 0, 1, 3, 4))?.contiguous()?)
                };
                let of_shared = scores(&together(&queries)?, &shared.keys.squeeze(0)?)?;
                let count = of_shared.dim(D::Minus1)?;
                let weights = softmax(&Tensor::cat(&[&apart(&of_shared)?, &of_own], D::Minus1)?)?;
                let of_shared = weights.narrow(D::Minus1, 0, count)?;
                let of_shared = weighted(&together(&of_shared)?, &shared.values.squeeze(0)?)?;
                let rest = weights.dim(D::Minus1)? - count;
                let of_own = weights.narrow(D::Minus1, count, rest)?.contiguous()?;
                (weighted(&of_own, &own.values)? + apart(&of_shared)?)?
            }
        };
        let attended = attended.permute((0, 3, 1, 2, 4))?;
        let attended = attended.reshape((b, f, n, self.count * self.dim))?;
        Ok((attended, new))
    }
}

/// Products of queries (.., m, dim) and keys (.., n, dim): (.., m, n).
fn scores(queries: &Tensor, keys: &Tensor) -> Result<Tensor> {
    of_each(&flat(queries)?.matmul(&flat(keys)?.t()?)?, queries)
}

/// Sums of values (.., n, dim), weighted by (.., m, n): (.., m, dim).
fn weighted(weights: &Tensor, values: &Tensor) -> Result<Tensor> {
    of_each(&flat(weights)?.matmul(&flat(values)?)?, weights)
}

/// One batch of matrices, as products want it.
fn flat(x: &Tensor) -> Result<Tensor> {
    Ok(x.flatten_to(x.rank().saturating_sub(3))?)
}

/// The matrices of `flat`, in the batch of `like`.
fn of_each(flat: &Tensor, like: &Tensor) -> Result<Tensor> {
    let mut shape = like.dims().to_vec();
    if let Some(last) = shape.last_mut() {
        *last = flat.dim(D::Minus1)?;
    }
    Ok(flat.reshape(shape)?)
}

/// Over the last dimension; computed in f32.
fn softmax(scores: &Tensor) -> Result<Tensor> {
    let format = scores.dtype();
    let scores = scores.to_dtype(DType::F32)?;
    let powers = scores
        .broadcast_sub(&scores.max_keepdim(D::Minus1)?)?
        .exp()?;
    let weights = powers.broadcast_div(&powers.sum_keepdim(D::Minus1)?)?;
    Ok(weights.to_dtype(format)?)
}

/// What is added to `scores` (.., frames, keys) of new frames, whose keys are the last ones: none sees a later one.
fn causal(frames: usize, scores: &Tensor) -> Result<Tensor> {
    let keys = scores.dim(D::Minus1)?;
    let before = keys - frames;
    let of_query = |query: usize| {
        (0..keys).map(move |key| match key <= before + query {
            true => 0.0,
            false => f32::NEG_INFINITY,
        })
    };
    let bias: Vec<f32> = (0..frames).flat_map(of_query).collect();
    let bias = Tensor::from_vec(bias, (frames, keys), scores.device())?;
    Ok(bias.to_dtype(scores.dtype())?)
}
