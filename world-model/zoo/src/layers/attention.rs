//! Attention.

use candle_core::{D, DType, Tensor};
use wm_model::Kernels;
use wm_model::NumberFormat;
use wm_model::ops::{AttentionShape, ScoreMask, dense_attention};

use super::host::with_heads;
use super::takes_kernels;
use crate::Result;
use crate::sizes::shape_error;

/// softmax(scale q k^T + mask) v, for `q` (B, heads, Lq, D), `k` and `v` (B, heads, Lk, D): (B, heads, Lq, D).
///
/// `mask` is added to the scores and may be broadcast to (B, heads, Lq, Lk). The softmax is taken in f32; the result
/// has the format of `q`. The kernels take views of any layout, multiply in `format`, and give the transpose of (B, Lq,
/// heads, D).
///
/// # Errors
/// If the shapes do not fit.
pub(crate) fn attention(
    (kernels, format): (Kernels, NumberFormat),
    [q, k, v]: [&Tensor; 3],
    scale: f64,
    mask: Option<&Tensor>,
) -> Result<Tensor> {
    if takes_kernels(kernels, q) {
        return on_kernel(format, [q, k, v], scale, mask);
    }
    let q = (q.contiguous()? * scale)?;
    let k = k.transpose(2, 3)?.contiguous()?;
    let scores = q.matmul(&k)?.to_dtype(DType::F32)?;
    let scores = match mask {
        Some(mask) => scores.broadcast_add(&mask.to_dtype(DType::F32)?)?,
        None => scores,
    };
    // The largest score is subtracted so that no exponential overflows. It cancels, and so do its gradients.
    let powers = scores
        .broadcast_sub(&scores.max_keepdim(D::Minus1)?.detach())?
        .exp()?;
    let weights = powers.broadcast_div(&powers.sum_keepdim(D::Minus1)?)?;
    Ok(weights.to_dtype(v.dtype())?.matmul(&v.contiguous()?)?)
}

fn on_kernel(
    format: NumberFormat,
    [q, k, v]: [&Tensor; 3],
    scale: f64,
    mask: Option<&Tensor>,
) -> Result<Tensor> {
    let (b, heads, queries, dim) = q.dims4()?;
    let keys = k.dim(2)?;
    for (what, tensor) in [("keys", k), ("values", v)] {
        if tensor.dims() != [b, heads, keys, dim] {
            let expected = format!("{what} ({b}, {heads}, {keys}, {dim})");
            return Err(shape_error(
                "the keys or values of an attention",
                expected,
                tensor,
            ));
        }
    }
    let shape = AttentionShape {
        batch: b,
        heads,
        queries,
        keys,
        dim,
    };
    let mask = mask.map(|mask| keys_whole(mask, shape)).transpose()?;
    let mask = mask.as_ref().map(|(values, sizes)| ScoreMask {
        values,
        sizes: *sizes,
    });
    let out = with_heads(q, |q| {
        with_heads(k, |k| {
            with_heads(v, |v| {
                dense_attention(shape, [q, k, v], scale as f32, mask, format)
            })
        })
    })???;
    let out = Tensor::from_vec(out, (b, queries, heads, dim), q.device())?;
    Ok(out.transpose(1, 2)?)
}

/// The values of a mask, with a value for every key and not repeated otherwise, and how many batch entries, heads and
/// queries they are for.
fn keys_whole(mask: &Tensor, shape: AttentionShape) -> Result<(Vec<f32>, [usize; 3])> {
    let whole = [shape.batch, shape.heads, shape.queries, shape.keys];
    let mut sizes = [1; 4];
    let own = sizes.iter_mut().rev().zip(mask.dims().iter().rev());
    own.for_each(|(size, own)| *size = *own);
    let fits = |(size, of): (&usize, usize)| *size == 1 || *size == of;
    if mask.rank() > sizes.len() || !sizes.iter().zip(whole).all(fits) {
        let expected = format!("what can be broadcast to {whole:?}");
        return Err(shape_error("the mask of an attention", expected, mask));
    }
    let [batch, heads, queries, _] = sizes;
    let mask = mask.to_dtype(DType::F32)?.reshape(&sizes)?;
    let mask = mask.broadcast_as((batch, heads, queries, shape.keys))?;
    Ok((mask.flatten_all()?.to_vec1()?, [batch, heads, queries]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;
    use wm_model::random;

    #[test]
    fn equal_keys_give_the_mean_of_the_values_that_are_not_masked() {
        let q = random::normal(&[2, 3, 4, 8], 1).unwrap();
        let k = Tensor::ones((2, 3, 5, 8), DType::F32, &Device::Cpu).unwrap();
        let v = Tensor::arange(0f32, 5.0, &Device::Cpu).unwrap();
        let v = v.reshape((1, 1, 5, 1)).unwrap();
        let v = v.broadcast_as((2, 3, 5, 8)).unwrap();
        let mean = |kernels: Kernels, mask: Option<&Tensor>| -> f32 {
            let y = attention((kernels, NumberFormat::F32), [&q, &k, &v], 0.3, mask).unwrap();
            assert_eq!(y.dims(), [2, 3, 4, 8]);
            y.mean_all().unwrap().to_scalar().unwrap()
        };
        let mask = [0f32, 0.0, f32::NEG_INFINITY, f32::NEG_INFINITY, 0.0];
        let mask = Tensor::new(&mask, &Device::Cpu).unwrap();
        let mask = mask.reshape((1, 1, 1, 5)).unwrap();
        for kernels in [Kernels::Candle, Kernels::Cpu] {
            assert!((mean(kernels, None) - 2.0).abs() < 1e-5);
            assert!((mean(kernels, Some(&mask)) - 5.0 / 3.0).abs() < 1e-5);
        }
    }

    #[test]
    fn both_engines_broadcast_every_mask_alike() {
        let normal = |dims: [usize; 4], seed| random::normal(&dims, seed).unwrap();
        let (q, k, v) = (
            normal([2, 3, 4, 8], 1),
            normal([2, 3, 5, 8], 2),
            normal([2, 3, 5, 8], 3),
        );
        let run = |kernels: Kernels, mask: &Tensor| {
            attention((kernels, NumberFormat::F32), [&q, &k, &v], 0.3, Some(mask)).map(|y| {
                let values: Vec<f32> = y.flatten_all().unwrap().to_vec1().unwrap();
                values
            })
        };
        for dims in [
            vec![2, 3, 4, 5],
            vec![2, 1, 1, 5],
            vec![1, 3, 4, 1],
            vec![4, 5],
        ] {
            let mask = (random::normal(&dims, 4).unwrap() * 2.0).unwrap();
            let (found, expected) = (run(Kernels::Cpu, &mask), run(Kernels::Candle, &mask));
            for (found, expected) in found.unwrap().iter().zip(expected.unwrap()) {
                assert!((found - expected).abs() < 1e-5, "{dims:?}");
            }
        }
        let mask = Tensor::zeros((3, 1, 1, 5), DType::F32, &Device::Cpu).unwrap();
        let error = run(Kernels::Cpu, &mask).unwrap_err().to_string();
        assert!(
            error.contains("mask") && error.contains("[3, 1, 1, 5]"),
            "{error}"
        );
    }
}
