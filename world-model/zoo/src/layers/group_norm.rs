//! Group normalisation.

use candle_core::{D, DType, Tensor};
use wm_model::Kernels;
use wm_model::ops;

use super::{host, takes_kernels};
use crate::Result;

/// Mean 0 and variance 1 over all places of a group of neighbouring channels, then a learned scale and shift of each
/// channel.
#[derive(Clone, Debug)]
pub(crate) struct GroupNorm {
    /// (channels).
    scale: Tensor,
    /// (channels).
    shift: Tensor,
    groups: usize,
    eps: f64,
    kernels: Kernels,
}

impl GroupNorm {
    /// `scale` and `shift` are (channels), of which `groups` must be a divisor; `eps` is added to the variance.
    ///
    /// # Errors
    /// If it is none, or the shapes differ.
    pub(crate) fn new(
        (scale, shift): (Tensor, Tensor),
        groups: usize,
        eps: f64,
        kernels: Kernels,
    ) -> Result<Self> {
        let channels = scale.dims1()?;
        if shift.dims() != [channels] || groups == 0 || !channels.is_multiple_of(groups) {
            return Err(wm_model::Error::Shape {
                what: "scale and shift of a GroupNorm",
                expected: format!("(channels) twice, a multiple of {groups}"),
                found: vec![channels, shift.elem_count()],
            }
            .into());
        }
        Ok(Self {
            scale,
            shift,
            groups,
            eps,
            kernels,
        })
    }

    /// `x` (N, H, W, C) to the same shape. Computed in f32, given back in the format of `x`.
    ///
    /// # Errors
    /// If `x` has another number of channels.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.check(x)?;
        if takes_kernels(self.kernels, x) {
            return self.on_kernel(x, ops::Activation::None);
        }
        if self.is_trained(x) {
            return self.trained(x, ops::Activation::None);
        }
        self.on_candle(x)
    }

    /// As [`GroupNorm::forward`], and SiLU after it.
    ///
    /// # Errors
    /// If `x` has another number of channels.
    pub(crate) fn forward_silu(&self, x: &Tensor) -> Result<Tensor> {
        self.check(x)?;
        if takes_kernels(self.kernels, x) {
            return self.on_kernel(x, ops::Activation::Silu);
        }
        if self.is_trained(x) {
            return self.trained(x, ops::Activation::Silu);
        }
        Ok(self.on_candle(x)?.silu()?)
    }

    /// What [`GroupNorm::forward_silu`] does to each image of `x`, f32 on the CPU, for a convolution that does it to its
    /// input.
    ///
    /// # Errors
    /// If `x` has another number of channels.
    pub(crate) fn silu_normalisations(&self, x: &Tensor) -> Result<Vec<ops::Normalisation>> {
        self.check(x)?;
        let (_, h, w, _) = x.dims4()?;
        let (scale, shift) = (self.scale.to_vec1::<f32>()?, self.shift.to_vec1::<f32>()?);
        let (affine, silu) = ((scale.as_slice(), shift.as_slice()), ops::Activation::Silu);
        host::with_values(x, |x| {
            ops::group_normalisations(x, h * w, self.groups, affine, self.eps, silu)
        })
    }

    fn check(&self, x: &Tensor) -> Result<()> {
        let channels = self.scale.dim(0)?;
        match x.dims4() {
            Ok((_, _, _, found)) if found == channels => Ok(()),
            _ => Err(wm_model::Error::Shape {
                what: "the input of a GroupNorm",
                expected: format!("(N, H, W, {channels})"),
                found: x.dims().to_vec(),
            }
            .into()),
        }
    }

    /// Whether gradients are to be propagated on the CPU: that of a dozen small operations takes many times as long.
    fn is_trained(&self, x: &Tensor) -> bool {
        let is_tracked = x.track_op() || self.scale.track_op() || self.shift.track_op();
        let all = [x, &self.scale, &self.shift];
        is_tracked && x.device().is_cpu() && all.iter().all(|x| x.dtype() == DType::F32)
    }

    fn trained(&self, x: &Tensor, activation: ops::Activation) -> Result<Tensor> {
        let affine = (&self.scale, &self.shift);
        let y = ops::differentiable_group_norm(x, self.groups, affine, self.eps, activation)?;
        Ok(y)
    }

    fn on_kernel(&self, x: &Tensor, activation: ops::Activation) -> Result<Tensor> {
        let (_, h, w, _) = x.dims4()?;
        let (scale, shift) = (self.scale.to_vec1::<f32>()?, self.shift.to_vec1::<f32>()?);
        let affine = (scale.as_slice(), shift.as_slice());
        host::changed(x, |x| {
            ops::group_norm(x, h * w, self.groups, affine, self.eps, activation);
        })
    }

    fn on_candle(&self, x: &Tensor) -> Result<Tensor> {
        let (n, h, w, channels) = x.dims4()?;
        // A row's mean first, then the mean of the rows: one running f32 sum over a large picture would round away
        // more than the tolerance of the models' outputs.
        let size = channels / self.groups;
        let grouped = x
            .to_dtype(DType::F32)?
            .reshape((n, h, w, self.groups, size))?
            .permute((0, 3, 1, 2, 4))?
            .reshape((n, self.groups, h, w * size))?;
        let mean = |x: &Tensor| x.mean_keepdim(D::Minus1)?.mean_keepdim(2);
        let centred = grouped.broadcast_sub(&mean(&grouped)?)?;
        let variance = mean(&centred.sqr()?)?;
        let normed = centred
            .broadcast_div(&(variance + self.eps)?.sqrt()?)?
            .reshape((n, self.groups, h, w, size))?
            .permute((0, 2, 3, 1, 4))?
            .reshape((n, h, w, channels))?;
        let scaled = normed
            .broadcast_mul(&self.scale.to_dtype(DType::F32)?)?
            .broadcast_add(&self.shift.to_dtype(DType::F32)?)?;
        Ok(scaled.to_dtype(x.dtype())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    /// Values with this mean and a standard deviation of 2.
    fn random(shape: &[usize], seed: u64, mean: f64) -> Tensor {
        let values = wm_model::random::normal(shape, seed).unwrap();
        values.affine(2.0, mean).unwrap()
    }

    #[test]
    fn both_engines_agree() {
        let (scale, shift) = (random(&[12], 1, 1.0), random(&[12], 2, 1.0));
        let x = random(&[2, 5, 7, 12], 3, 1.0);
        let [a, b] = [Kernels::Candle, Kernels::Cpu].map(|kernels| {
            let norm = GroupNorm::new((scale.clone(), shift.clone()), 4, 1e-6, kernels).unwrap();
            norm.forward(&x).unwrap()
        });
        let difference = (a - b).unwrap().abs().unwrap().max_all().unwrap();
        assert!(difference.to_scalar::<f32>().unwrap() < 2e-5);
    }

    #[test]
    fn gradients_are_candles() {
        let var = |shape: &[usize], seed| Var::from_tensor(&random(shape, seed, 0.5)).unwrap();
        let (scale, shift, x) = (var(&[12], 1), var(&[12], 2), var(&[2, 9, 7, 12], 3));
        let weight = wm_model::random::normal(&[2, 9, 7, 12], 4).unwrap();
        let affine = (scale.as_tensor().clone(), shift.as_tensor().clone());
        let norm = GroupNorm::new(affine, 4, 1e-6, Kernels::Candle).unwrap();
        assert!(norm.is_trained(&x));
        let of = |y: Tensor| {
            let store = (y * &weight).unwrap().sum_all().unwrap().backward();
            let store = store.unwrap();
            [&x, &scale, &shift].map(|var| store.get(var).unwrap().clone())
        };
        let plain = norm.on_candle(&x).unwrap();
        for (found, expected) in [
            (norm.forward_silu(&x).unwrap(), plain.silu().unwrap()),
            (norm.forward(&x).unwrap(), plain),
        ] {
            for (found, expected) in of(found).into_iter().zip(of(expected)) {
                let scalar = |x: Tensor| x.abs().unwrap().max_all().unwrap().to_scalar::<f32>();
                let difference = scalar((&found - &expected).unwrap()).unwrap();
                assert!(
                    difference < 1e-5 * scalar(expected).unwrap(),
                    "{difference}"
                );
            }
        }
    }

    #[test]
    fn every_group_of_a_picture_gets_mean_zero_and_variance_one() {
        let ones = Tensor::ones(6, DType::F32, &Device::Cpu).unwrap();
        let zeros = ones.zeros_like().unwrap();
        let norm = GroupNorm::new((ones, zeros), 2, 0.0, Kernels::Candle).unwrap();
        let x = random(&[2, 4, 4, 6], 1, 3.0);
        let y = norm.forward(&x).unwrap().narrow(3, 3, 3).unwrap();
        let y = y.get(1).unwrap().flatten_all().unwrap();
        let scalar = |x: Tensor| x.mean_all().unwrap().to_scalar::<f32>().unwrap();
        assert!((scalar(y.sqr().unwrap()) - 1.0).abs() < 1e-4);
        assert!(scalar(y).abs() < 1e-5);
    }
}
