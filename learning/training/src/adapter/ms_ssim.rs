use anyhow::{Result, ensure};
use candle_core::{D, Device, Tensor};

/// Side of the Gaussian window.
const WINDOW: usize = 11;
/// Its standard deviation \[px\].
const SIGMA: f64 = 1.5;
/// Weights of the scales, finest first.
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];
/// Keep quotients finite, for values in 0..1.
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;
/// Lower bound of similarities in powers, whose slope is infinite at 0.
const LEAST: f64 = 1e-6;

/// Multi-scale structural similarity (Wang et al. 2003) of pictures in 0..1, by matrix products along both axes, with
/// gradients.
///
/// As in pytorch_msssim, windows lie inside the picture, and similarity is averaged over colours. Pictures with a side
/// below 161 have only the scales that fit the window, with weights rescaled to the sum of all five.
#[derive(Debug)]
pub struct MsSsim {
    scales: Vec<Scale>,
}

#[derive(Debug)]
struct Scale {
    weight: f64,
    /// Window along columns and rows: (side, side - 10).
    window: [Tensor; 2],
    /// Halving to the next scale: (side, half the side, rounded up).
    halving: [Tensor; 2],
}

impl MsSsim {
    /// For pictures of `size` (height, width).
    ///
    /// # Errors
    /// If a side is shorter than the window.
    pub fn new(size: (usize, usize)) -> Result<Self> {
        let mut sides = [size.0, size.1];
        ensure!(
            sides.iter().all(|side| *side >= WINDOW),
            "pictures of {}x{}: MS-SSIM needs {WINDOW} pixels in both directions",
            size.0,
            size.1
        );
        let mut scales = Vec::new();
        for weight in WEIGHTS {
            if sides.iter().any(|side| *side < WINDOW) {
                break;
            }
            let [h, w] = sides;
            scales.push(Scale {
                weight,
                window: [window(h)?, window(w)?],
                halving: [halving(h)?, halving(w)?],
            });
            sides = sides.map(|side| side.div_ceil(2));
        }
        let sum: f64 = scales.iter().map(|scale| scale.weight).sum();
        for scale in &mut scales {
            scale.weight *= WEIGHTS.iter().sum::<f64>() / sum;
        }
        Ok(Self { scales })
    }

    /// Moves the tables to `device`.
    ///
    /// # Errors
    /// If they do not fit there.
    pub fn on(mut self, device: &Device) -> Result<Self> {
        for scale in &mut self.scales {
            for table in scale.window.iter_mut().chain(&mut scale.halving) {
                *table = table.to_device(device)?;
            }
        }
        Ok(self)
    }

    /// Number of scales.
    #[must_use]
    pub fn scales(&self) -> usize {
        self.scales.len()
    }

    /// Mean similarity of pictures `a` and `b` (N, H, W, C): a scalar.
    ///
    /// # Errors
    /// If they have another size.
    pub fn of(&self, a: &Tensor, b: &Tensor) -> Result<Tensor> {
        let (mut a, mut b) = (planes(a)?, planes(b)?);
        let mut product: Option<Tensor> = None;
        for (index, scale) in self.scales.iter().enumerate() {
            let is_last = index + 1 == self.scales.len();
            let similarity = scale.similarity(&a, &b, is_last)?;
            // Negative similarity counts as 0.
            let is_like = similarity.detach().gt(0.0)?.to_dtype(similarity.dtype())?;
            let factor = (similarity.maximum(LEAST)?.powf(scale.weight)? * is_like)?;
            product = Some(match product {
                None => factor,
                Some(product) => (product * factor)?,
            });
            if !is_last {
                (a, b) = (
                    along_both(&a, &scale.halving)?,
                    along_both(&b, &scale.halving)?,
                );
            }
        }
        match product {
            Some(product) => Ok(product.mean_all()?),
            None => Ok(Tensor::ones((), a.dtype(), a.device())?),
        }
    }
}

impl Scale {
    /// Mean over the positions of each plane: contrast and structure, with luminance at the last scale.
    fn similarity(&self, a: &Tensor, b: &Tensor, with_luminance: bool) -> Result<Tensor> {
        let count = a.dim(0)?;
        let products = [a.clone(), b.clone(), a.sqr()?, b.sqr()?, (a * b)?];
        let blurred = along_both(&Tensor::cat(&products, 0)?, &self.window)?;
        let part = |index: usize| blurred.narrow(0, index * count, count);
        let (mean_a, mean_b) = (part(0)?, part(1)?);
        let (square_a, square_b) = (mean_a.sqr()?, mean_b.sqr()?);
        let between = (&mean_a * &mean_b)?;
        let variances = ((part(2)? - &square_a)? + (part(3)? - &square_b)?)?;
        let covariance = (part(4)? - &between)?;
        let mut map = (((covariance * 2.0)? + C2)? / (variances + C2)?)?;
        if with_luminance {
            let luminance = (((between * 2.0)? + C1)? / ((square_a + square_b)? + C1)?)?;
            map = (map * luminance)?;
        }
        Ok(map.mean(D::Minus1)?.mean(D::Minus1)?)
    }
}

/// (N, H, W, C) to (N C, H, W).
fn planes(x: &Tensor) -> Result<Tensor> {
    let (n, h, w, c) = x.dims4()?;
    Ok(x.permute((0, 3, 1, 2))?
        .contiguous()?
        .reshape((n * c, h, w))?)
}

/// (P, H, W) to (P, h, w), by matrices (H, h) and (W, w).
fn along_both(x: &Tensor, [rows, columns]: &[Tensor; 2]) -> Result<Tensor> {
    // Columns first, then rows, each along the last dimension.
    let x = along(x, columns)?.transpose(1, 2)?.contiguous()?;
    Ok(along(&x, rows)?.transpose(1, 2)?.contiguous()?)
}

fn along(x: &Tensor, matrix: &Tensor) -> Result<Tensor> {
    let (planes, lines, length) = x.dims3()?;
    let y = x.reshape((planes * lines, length))?.matmul(matrix)?;
    Ok(y.reshape((planes, lines, matrix.dim(1)?))?)
}

fn window(side: usize) -> Result<Tensor> {
    let at = |tap: usize| {
        let distance = tap as f64 - (WINDOW / 2) as f64;
        (-distance * distance / (2.0 * SIGMA * SIGMA)).exp()
    };
    let sum: f64 = (0..WINDOW).map(at).sum();
    matrix(side, side - (WINDOW - 1), |from, to| {
        let tap = from.checked_sub(to).filter(|tap| *tap < WINDOW);
        tap.map_or(0.0, |tap| at(tap) / sum)
    })
}

/// Means of two neighbours; an odd side starts beside a zero, as in pytorch_msssim.
fn halving(side: usize) -> Result<Tensor> {
    let shift = side % 2;
    matrix(side, side.div_ceil(2), |from, to| {
        match (from + shift) / 2 == to {
            true => 0.5,
            false => 0.0,
        }
    })
}

fn matrix(inputs: usize, outputs: usize, at: impl Fn(usize, usize) -> f64) -> Result<Tensor> {
    let mut values = Vec::with_capacity(inputs * outputs);
    for from in 0..inputs {
        values.extend((0..outputs).map(|to| at(from, to) as f32));
    }
    Ok(Tensor::from_vec(values, (inputs, outputs), &Device::Cpu)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_pictures_have_fewer_scales() {
        let scales = |side| MsSsim::new((side, 256)).unwrap().scales();
        assert_eq!([11, 21, 32, 128, 161, 256].map(scales), [1, 2, 2, 4, 5, 5]);
        let error = MsSsim::new((10, 64)).unwrap_err().to_string();
        assert!(error.contains("10x64"), "{error}");
    }

    #[test]
    fn equal_pictures_have_similarity_one() {
        let x = wm_model::random::uniform(&[2, 37, 30, 3], 1).unwrap();
        let of = MsSsim::new((37, 30)).unwrap().of(&x, &x).unwrap();
        assert!((of.to_scalar::<f32>().unwrap() - 1.0).abs() < 1e-5);
    }
}
