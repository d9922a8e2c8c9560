//! Linear maps along the rows and the columns of pictures and feature grids.

use candle_core::{DType, Device, Tensor};
use rayon::prelude::*;

use crate::Result;
use crate::layers::host;
use crate::sizes::shape_error;

/// How outputs along one axis are weighted sums of inputs: a matrix (outputs, inputs), dense as [`by_products`] takes it.
#[derive(Clone, Debug)]
pub(crate) struct AxisWeights {
    inputs: usize,
    outputs: usize,
    values: Vec<f32>,
}

impl AxisWeights {
    /// PyTorch's cubic convolution to another size: a = -0.75, half-pixel centres, borders
    /// repeated, no antialiasing. Four taps an output. (`upsample_bicubic2d`, align_corners off.)
    /// wm_evaluation resamples for ONNX networks in f64; one function for both would change the bits of one of them.
    pub(crate) fn bicubic(inputs: usize, outputs: usize) -> Self {
        let mut weights = Self::zero(inputs, outputs);
        // In f32, as PyTorch computes it for f32 pictures: the taps then agree to the last bit.
        let scale = inputs as f32 / outputs as f32;
        for output in 0..outputs {
            let centre = scale * (output as f32 + 0.5) - 0.5;
            let first = centre.floor();
            for (offset, tap) in (-1_i64..).zip(cubic_taps(centre - first)) {
                let input = (first as i64 + offset).clamp(0, inputs as i64 - 1);
                weights.add(output, input as usize, tap);
            }
        }
        weights
    }

    /// PyTorch's adaptive average pooling: output i is the mean of the inputs from
    /// floor(i n / m) up to ceil((i + 1) n / m).
    pub(crate) fn adaptive_average(inputs: usize, outputs: usize) -> Self {
        let mut weights = Self::zero(inputs, outputs);
        for output in 0..outputs {
            let start = output * inputs / outputs;
            let end = ((output + 1) * inputs).div_ceil(outputs);
            for input in start..end {
                weights.add(output, input, 1.0 / (end - start) as f32);
            }
        }
        weights
    }

    fn zero(inputs: usize, outputs: usize) -> Self {
        Self {
            inputs,
            outputs,
            values: vec![0.0; inputs * outputs],
        }
    }

    fn add(&mut self, output: usize, input: usize, weight: f32) {
        if let Some(value) = self.values.get_mut(output * self.inputs + input) {
            *value += weight;
        }
    }

    /// For each output: the index of its first input with a weight, and the weights from that input to the last one.
    fn windows(&self) -> Vec<(usize, &[f32])> {
        let windows = self.values.chunks_exact(self.inputs.max(1)).map(|weights| {
            let is_nonzero = |weight: &f32| *weight != 0.0;
            let first = weights.iter().position(is_nonzero).unwrap_or(0);
            let end = weights
                .iter()
                .rposition(is_nonzero)
                .map_or(first, |last| last + 1);
            (first, weights.get(first..end).unwrap_or_default())
        });
        windows.collect()
    }

    /// (outputs, inputs).
    fn tensor(&self, device: &Device) -> Result<Tensor> {
        let shape = (self.outputs, self.inputs);
        Ok(Tensor::from_slice(&self.values, shape, device)?)
    }

    /// Whether outputs are the inputs.
    fn is_identity(&self) -> bool {
        let diagonal =
            |(at, value): (usize, &f32)| *value == f32::from(at % self.inputs == at / self.inputs);
        self.inputs == self.outputs && self.values.iter().enumerate().all(diagonal)
    }
}

/// Weights of the inputs at -1, 0, 1, 2 for a place `t` in 0..1 between 0 and 1.
fn cubic_taps(t: f32) -> [f32; 4] {
    const A: f32 = -0.75;
    let near = |x: f32| ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0;
    let far = |x: f32| ((A * x - 5.0 * A) * x + 8.0 * A) * x - 4.0 * A;
    [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)]
}

/// Maps `grid` (N, H, W, C) along its rows and columns: (N, H', W', C), f32.
///
/// # Errors
/// If the grid has not the sizes that the weights are for.
pub(crate) fn resample(grid: &Tensor, rows: &AxisWeights, columns: &AxisWeights) -> Result<Tensor> {
    let &[_, h, w, _] = grid.dims() else {
        return Err(shape_error("the grid", "(N, H, W, C)", grid));
    };
    if (h, w) != (rows.inputs, columns.inputs) {
        let expected = format!("(N, {}, {}, C)", rows.inputs, columns.inputs);
        return Err(shape_error("the grid", expected, grid));
    }
    let grid = grid.to_dtype(DType::F32)?.contiguous()?;
    match host::is_plain(&grid) {
        true => by_windows(&grid, rows, columns),
        false => by_products(grid, rows, columns),
    }
}

/// [`resample`] on the CPU, without gradients.
fn by_windows(grid: &Tensor, rows: &AxisWeights, columns: &AxisWeights) -> Result<Tensor> {
    let (n, h, w, c) = grid.dims4()?;
    let (height, width) = (rows.outputs, columns.outputs);
    let mut resampled = vec![0.0; n * height * width * c];
    let (of_rows, of_columns) = (rows.windows(), columns.windows());
    host::with_values(grid, |grid| {
        let pictures = grid.chunks_exact((h * w * c).max(1));
        let resampled = resampled.chunks_exact_mut((height * width * c).max(1));
        for (picture, out) in pictures.zip(resampled) {
            out.par_chunks_mut((width * c).max(1))
                .zip(&of_rows)
                .for_each_init(
                    || vec![0.0; w * c],
                    |row, (out, (first, weights))| {
                        row.fill(0.0);
                        add_weighted(row, picture, *first, weights);
                        for (out, (first, weights)) in
                            out.chunks_exact_mut(c.max(1)).zip(&of_columns)
                        {
                            add_weighted(out, row, *first, weights);
                        }
                    },
                );
        }
    })?;
    Ok(Tensor::from_vec(
        resampled,
        (n, height, width, c),
        grid.device(),
    )?)
}

/// Adds to `sum` the parts of `values` from number `first` on, each as long as `sum`, times the `weights`.
fn add_weighted(sum: &mut [f32], values: &[f32], first: usize, weights: &[f32]) {
    let parts = values.chunks_exact(sum.len().max(1)).skip(first);
    for (part, weight) in parts.zip(weights) {
        for (sum, value) in sum.iter_mut().zip(part) {
            *sum += weight * value;
        }
    }
}

/// [`resample`] by products of dense matrices, on any device.
fn by_products(mut grid: Tensor, rows: &AxisWeights, columns: &AxisWeights) -> Result<Tensor> {
    let (n, h, w, c) = grid.dims4()?;
    if !rows.is_identity() {
        let weights = rows.tensor(grid.device())?.unsqueeze(0)?;
        grid = weights.broadcast_matmul(&grid.reshape((n, h, w * c))?)?;
    }
    let h = rows.outputs;
    if !columns.is_identity() {
        let weights = columns.tensor(grid.device())?.t()?;
        let channels_first = grid.reshape((n, h, w, c))?.transpose(2, 3)?;
        grid = channels_first
            .contiguous()?
            .reshape((n * h * c, w))?
            .matmul(&weights)?
            .reshape((n, h, c, columns.outputs))?
            .transpose(2, 3)?
            .contiguous()?;
    }
    Ok(grid.reshape((n, h, columns.outputs, c))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(weights: &AxisWeights, output: usize) -> Vec<(usize, f32)> {
        let start = output * weights.inputs;
        let values = &weights.values[start..start + weights.inputs];
        let taps = values.iter().copied().enumerate();
        taps.filter(|(_, weight)| *weight != 0.0).collect()
    }

    fn column_picture(values: &[f32]) -> Tensor {
        Tensor::from_slice(values, (1, values.len(), 1, 1), &Device::Cpu).unwrap()
    }

    #[test]
    fn taps_are_those_of_pytorch() {
        // torch.nn.functional.interpolate(mode="bicubic") doubles with places 1/4 and 3/4.
        let doubled = AxisWeights::bicubic(8, 16);
        let expected = [-0.10546875_f32, 0.87890625, 0.26171875, -0.03515625];
        assert_eq!(
            row(&doubled, 7),
            (2_usize..6).zip(expected).collect::<Vec<_>>(),
            "place 1/4 after input 3"
        );
        let mirrored: Vec<_> = (2_usize..6).zip(expected.into_iter().rev()).collect();
        assert_eq!(row(&doubled, 8), mirrored, "place 3/4 after input 3");
    }

    #[test]
    fn taps_beyond_the_border_repeat_it() {
        // The first output of a doubling lies at -1/4: the inputs -2, -1, 0 are all the first.
        let doubled = AxisWeights::bicubic(8, 16);
        let first = row(&doubled, 0);
        assert_eq!(first.len(), 2);
        assert!((first[0].1 - 283.0 / 256.0).abs() < 1e-6, "{first:?}");
        assert!((first[1].1 + 0.10546875).abs() < 1e-6, "{first:?}");
    }

    #[test]
    fn there_is_no_antialiasing() {
        // Even at a sixteenth of the size an output sees four inputs only.
        let shrunk = AxisWeights::bicubic(256, 16);
        for output in 0..16 {
            assert_eq!(row(&shrunk, output).len(), 4);
        }
        assert_eq!(
            row(&shrunk, 1)[0].0,
            22,
            "centre 23.5, first tap one before"
        );
    }

    #[test]
    fn a_constant_stays_a_constant() {
        let picture = Tensor::full(0.3_f32, (2, 256, 256, 3), &Device::Cpu).unwrap();
        let weights = AxisWeights::bicubic(256, 224);
        let resized = resample(&picture, &weights, &weights).unwrap();
        assert_eq!(resized.dims(), [2, 224, 224, 3]);
        let values = resized.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert!(values.iter().all(|v| (v - 0.3).abs() < 1e-6));
    }

    #[test]
    fn a_ramp_stays_a_ramp_away_from_the_borders() {
        // Only a = -0.5 reproduces a slope exactly: with a = -0.75 the taps' mean position at place
        // t is t + t (1 - t) (1 - 2 t) / 2, as follows from the kernel's polynomials.
        let ramp: Vec<f32> = (0..16).map(|v| v as f32).collect();
        let rows = AxisWeights::bicubic(16, 14);
        let columns = AxisWeights::bicubic(1, 1);
        let resized = resample(&column_picture(&ramp), &rows, &columns).unwrap();
        let values = resized.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        for (output, value) in values.iter().enumerate().take(12).skip(2) {
            let centre = 16.0 / 14.0 * (output as f32 + 0.5) - 0.5;
            let t = centre - centre.floor();
            let expected = centre + t * (1.0 - t) * (1.0 - 2.0 * t) / 2.0;
            assert!((value - expected).abs() < 1e-5, "{value} for {expected}");
        }
    }

    #[test]
    fn windows_and_products_give_the_same() {
        let grid = wm_model::random::normal(&[2, 9, 7, 5], 1).unwrap();
        for [rows, columns] in [
            [AxisWeights::bicubic(9, 4), AxisWeights::bicubic(7, 12)],
            [
                AxisWeights::bicubic(9, 9),
                AxisWeights::adaptive_average(7, 3),
            ],
        ] {
            let windows = by_windows(&grid, &rows, &columns).unwrap();
            let products = by_products(grid.clone(), &rows, &columns).unwrap();
            assert_eq!(windows.dims(), products.dims());
            let difference = (windows - products).unwrap().abs().unwrap();
            let most: f32 = difference.max_all().unwrap().to_scalar().unwrap();
            assert!(most < 1e-5, "they differ by {most}");
        }
    }

    #[test]
    fn rows_and_columns_are_not_mixed_up() {
        let picture = Tensor::arange(0.0_f32, 24.0, &Device::Cpu).unwrap();
        let picture = picture.reshape((1, 2, 4, 3)).unwrap();
        let rows = AxisWeights::adaptive_average(2, 1);
        let columns = AxisWeights::adaptive_average(4, 2);
        let pooled = resample(&picture, &rows, &columns).unwrap();
        let values = pooled.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(values, [7.5, 8.5, 9.5, 13.5, 14.5, 15.5]);
    }

    #[test]
    fn adaptive_windows_overlap_where_sizes_do_not_divide() {
        let weights = AxisWeights::adaptive_average(5, 2);
        let third = 1.0_f32 / 3.0;
        assert_eq!(row(&weights, 0), [(0, third), (1, third), (2, third)]);
        assert_eq!(row(&weights, 1), [(2, third), (3, third), (4, third)]);
    }

    #[test]
    fn the_same_size_is_left_alone() {
        assert!(AxisWeights::bicubic(7, 7).is_identity());
        assert!(!AxisWeights::bicubic(7, 8).is_identity());
    }
}
