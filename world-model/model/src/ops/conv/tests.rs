use candle_core::{Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::NumberFormat;
use crate::ops::simd::Bf16Unit;
use crate::ops::{Activation, group_norm, group_normalisations};

fn random(count: usize, seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Shapes with odd sizes, partial vectors, several panels, both strides and upsampling.
fn conv2d(
    shape: &ConvShape,
    (weight, bias): (&[f32], Option<&[f32]>),
    input: &[f32],
    grid: GridSize,
    epilogue: Fused<'_>,
    output: &mut Vec<f32>,
) -> Result<GridSize> {
    PackedConv::new(shape, weight, bias, NumberFormat::F32)?.run(input, grid, epilogue, output)
}

fn cases() -> Vec<(ConvShape, GridSize)> {
    let grid = |images, height, width| GridSize {
        images,
        height,
        width,
    };
    let conv = |inputs, outputs, kernel, stride, upsample| ConvShape {
        inputs,
        outputs,
        kernel,
        stride,
        upsample,
    };
    vec![
        (conv(3, 16, 3, 1, false), grid(2, 9, 7)),
        (conv(5, 3, 3, 1, false), grid(1, 6, 11)),
        (conv(16, 32, 3, 2, false), grid(2, 8, 10)),
        (conv(4, 20, 3, 2, false), grid(1, 7, 9)),
        (conv(6, 96, 3, 1, false), grid(1, 4, 17)),
        (conv(8, 80, 3, 1, true), grid(1, 3, 5)),
        (conv(33, 7, 3, 1, true), grid(2, 2, 2)),
        (conv(12, 64, 1, 1, false), grid(5, 3, 3)),
        (conv(4, 4, 1, 2, false), grid(1, 5, 4)),
        (conv(2, 18, 5, 2, false), grid(1, 9, 6)),
        (conv(2, 3, 5, 1, false), grid(1, 1, 1)),
        (conv(3, 5, 5, 1, true), grid(1, 4, 3)),
        (conv(3, 5, 1, 1, true), grid(2, 3, 4)),
    ]
}

struct Case {
    shape: ConvShape,
    grid: GridSize,
    input: Vec<f32>,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

impl Case {
    fn all() -> impl Iterator<Item = Self> {
        cases().into_iter().enumerate().map(|(i, (shape, grid))| {
            let seed = i as u64 * 10;
            Self {
                shape,
                grid,
                input: random(grid.pixels() * shape.inputs, seed),
                weight: random(shape.weights(), seed + 1),
                bias: random(shape.outputs, seed + 2),
            }
        })
    }

    fn forward(&self, input: &[f32], weight: &[f32], bias: &[f32]) -> Vec<f32> {
        let mut output = Vec::new();
        conv2d(
            &self.shape,
            (weight, Some(bias)),
            input,
            self.grid,
            Fused::default(),
            &mut output,
        )
        .unwrap();
        output
    }

    /// The same by the stock library, in f32.
    fn reference(&self) -> Vec<f32> {
        let ConvShape {
            inputs,
            outputs,
            kernel,
            stride,
            upsample,
        } = self.shape;
        let GridSize {
            images,
            height,
            width,
        } = self.grid;
        let cpu = &Device::Cpu;
        let mut x = Tensor::from_slice(&self.input, (images, height, width, inputs), cpu)
            .unwrap()
            .permute((0, 3, 1, 2))
            .unwrap()
            .contiguous()
            .unwrap();
        if upsample {
            x = x.upsample_nearest2d(2 * height, 2 * width).unwrap();
        }
        let w = Tensor::from_slice(&self.weight, (kernel, kernel, inputs, outputs), cpu)
            .unwrap()
            .permute((3, 2, 0, 1))
            .unwrap()
            .contiguous()
            .unwrap();
        let b = Tensor::from_slice(&self.bias, (1, outputs, 1, 1), cpu).unwrap();
        x.conv2d(&w, kernel / 2, stride, 1, 1)
            .unwrap()
            .broadcast_add(&b)
            .unwrap()
            .permute((0, 2, 3, 1))
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap()
    }
}

fn assert_close(what: &str, shape: ConvShape, found: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(found.len(), expected.len(), "{what} {shape:?}");
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let bound = tolerance * (1.0 + b.abs());
        assert!(
            (a - b).abs() <= bound,
            "{what} {shape:?} at {i}: {a}, expected {b}"
        );
    }
}

#[test]
fn forward_equals_the_stock_convolution() {
    for case in Case::all() {
        let found = case.forward(&case.input, &case.weight, &case.bias);
        assert_close("forward", case.shape, &found, &case.reference(), 2e-5);
    }
}

#[test]
fn residual_and_relu_come_after_the_sum() {
    for case in Case::all() {
        let plain = case.forward(&case.input, &case.weight, &case.bias);
        let residual = random(plain.len(), 77);
        let mut output = Vec::new();
        let epilogue = Fused {
            normalisations: None,
            residual: Some(&residual),
            relu: true,
        };
        let weights = (case.weight.as_slice(), Some(case.bias.as_slice()));
        conv2d(
            &case.shape,
            weights,
            &case.input,
            case.grid,
            epilogue,
            &mut output,
        )
        .unwrap();
        let expected: Vec<f32> = plain
            .iter()
            .zip(&residual)
            .map(|(v, r)| (v + r).max(0.0))
            .collect();
        assert_close("epilogue", case.shape, &output, &expected, 1e-6);
    }
}

/// The loss is sum(c * conv(x)), linear in each argument, so a central difference is exact up to
/// rounding and the step can be large.
fn difference(loss: impl Fn(&[f32]) -> f64, at: &[f32], index: usize) -> f32 {
    let step = 0.5;
    let mut moved = at.to_vec();
    moved[index] = at[index] + step;
    let up = loss(&moved);
    moved[index] = at[index] - step;
    ((up - loss(&moved)) / (2.0 * f64::from(step))) as f32
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| f64::from(*a) * f64::from(*b))
        .sum()
}

/// Some forty places spread over `length`.
fn places(length: usize) -> impl Iterator<Item = usize> {
    (0..length).step_by(length.div_ceil(41))
}

#[test]
fn gradients_equal_finite_differences() {
    for case in Case::all() {
        let output = case.forward(&case.input, &case.weight, &case.bias);
        let gradient = random(output.len(), 5);
        let mut by_input = vec![9.0; case.input.len()];
        conv2d_input_gradient(
            &case.shape,
            &case.weight,
            &gradient,
            case.grid,
            None,
            None,
            &mut by_input,
        )
        .unwrap();
        let mut by_weight = vec![9.0; case.weight.len()];
        let mut by_bias = vec![9.0; case.bias.len()];
        conv2d_weight_gradient(
            &case.shape,
            &case.input,
            &gradient,
            case.grid,
            &mut by_weight,
            Some(&mut by_bias),
        )
        .unwrap();
        let check = |what: &str, found: &[f32], at: &[f32], loss: &dyn Fn(&[f32]) -> f64| {
            for i in places(at.len()) {
                let expected = difference(loss, at, i);
                let bound = 1e-3 * (1.0 + expected.abs());
                assert!(
                    (found[i] - expected).abs() < bound,
                    "{what} {:?} at {i}: {}, expected {expected}",
                    case.shape,
                    found[i]
                );
            }
        };
        check("input", &by_input, &case.input, &|x| {
            dot(&gradient, &case.forward(x, &case.weight, &case.bias))
        });
        check("weight", &by_weight, &case.weight, &|w| {
            dot(&gradient, &case.forward(&case.input, w, &case.bias))
        });
        check("bias", &by_bias, &case.bias, &|b| {
            dot(&gradient, &case.forward(&case.input, &case.weight, b))
        });
    }
}

#[test]
fn input_gradient_adds_the_residual_and_then_masks() {
    for case in Case::all() {
        let target = case.shape.output(case.grid);
        let gradient = random(target.pixels() * case.shape.outputs, 6);
        let residual = random(case.input.len(), 7);
        let run = |residual, mask| {
            let mut output = vec![9.0; case.input.len()];
            conv2d_input_gradient(
                &case.shape,
                &case.weight,
                &gradient,
                case.grid,
                residual,
                mask,
                &mut output,
            )
            .unwrap();
            output
        };
        let plain = run(None, None);
        let found = run(Some(residual.as_slice()), Some(case.input.as_slice()));
        let expected: Vec<f32> = plain
            .iter()
            .zip(&residual)
            .zip(&case.input)
            .map(|((v, r), x)| if *x > 0.0 { v + r } else { 0.0 })
            .collect();
        assert_close("masked", case.shape, &found, &expected, 1e-6);
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let shape = ConvShape::same(16, 24, 3);
    let grid = GridSize {
        images: 3,
        height: 20,
        width: 20,
    };
    let input = random(grid.pixels() * 16, 1);
    let gradient = random(grid.pixels() * 24, 2);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut by_weight = vec![0.0; shape.weights()];
            conv2d_weight_gradient(&shape, &input, &gradient, grid, &mut by_weight, None).unwrap();
            by_weight
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn a_slice_of_the_wrong_length_is_named() {
    let shape = ConvShape::same(2, 2, 3);
    let grid = GridSize {
        images: 1,
        height: 4,
        width: 4,
    };
    let weight = [0.0; 36];
    let error = conv2d(
        &shape,
        (&weight, None),
        &[0.0; 31],
        grid,
        Fused::default(),
        &mut Vec::new(),
    )
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "convolution input has shape [31], expected [32]"
    );
}

/// A 3x3 convolution by the plain sum, in f64.
fn by_definition(case: &Case) -> Vec<f64> {
    let Case { shape, grid, .. } = case;
    let target = shape.output(*grid);
    let mut out = Vec::new();
    for image in 0..grid.images {
        for y in 0..target.height {
            for x in 0..target.width {
                for n in 0..shape.outputs {
                    let mut sum = f64::from(case.bias[n]);
                    for tap in 0..9 {
                        let row = (y + tap / 3).wrapping_sub(1);
                        let column = (x + tap % 3).wrapping_sub(1);
                        if row >= grid.height || column >= grid.width {
                            continue;
                        }
                        let pixel = (image * grid.height + row) * grid.width + column;
                        for k in 0..shape.inputs {
                            let value = case.input[pixel * shape.inputs + k];
                            let weight = case.weight[(tap * shape.inputs + k) * shape.outputs + n];
                            sum += f64::from(value) * f64::from(weight);
                        }
                    }
                    out.push(sum);
                }
            }
        }
    }
    out
}

/// Every way to compute a 3x3 convolution, with everything that is done on the way.
#[test]
fn inference_is_the_plain_sum() {
    let grid = |images, height, width| GridSize {
        images,
        height,
        width,
    };
    for (inputs, outputs, grid) in [
        (32, 48, grid(2, 19, 17)),
        (64, 48, grid(1, 1, 33)),
        (48, 32, grid(1, 16, 2)),
        (3, 20, grid(1, 7, 50)),
    ] {
        let shape = ConvShape::same(inputs, outputs, 3);
        let case = Case {
            shape,
            grid,
            input: random(grid.pixels() * inputs, 1),
            weight: random(shape.weights(), 2),
            bias: random(outputs, 3),
        };
        let residual = random(grid.pixels() * outputs, 4);
        let affine = (random(inputs, 5), random(inputs, 6));
        let pixels = grid.height * grid.width;
        // A group a channel would leave nothing of small pictures.
        let normalisations = group_normalisations(
            &case.input,
            pixels,
            1,
            (&affine.0, &affine.1),
            1e-5,
            Activation::Silu,
        );
        let mut normalised = case.input.clone();
        group_norm(
            &mut normalised,
            pixels,
            1,
            (&affine.0, &affine.1),
            1e-5,
            Activation::Silu,
        );
        let normalised = Case {
            input: normalised,
            weight: case.weight.clone(),
            bias: case.bias.clone(),
            ..case
        };
        let (weight, bias) = (case.weight.as_slice(), Some(case.bias.as_slice()));
        for (format, tolerance) in [(NumberFormat::F32, 2e-5), (NumberFormat::Bf16, 3e-2)] {
            let mut ways = vec![
                PackedConv::new(&shape, weight, bias, format),
                PackedConv::for_inference(&shape, weight, bias, format),
            ];
            if format == NumberFormat::Bf16 {
                let units = Bf16Unit::ALL.iter().copied();
                for unit in units.filter(|unit| unit.can_be_tested()) {
                    ways.push(PackedConv::of_unit(&shape, weight, bias, Some(unit)));
                    ways.push(PackedConv::transformed(&shape, weight, bias, Some(unit)));
                }
            }
            for (way, packed) in ways.into_iter().enumerate() {
                let packed = packed.unwrap();
                for is_normalised in [false, true] {
                    let expected = match is_normalised {
                        true => by_definition(&normalised),
                        false => by_definition(&case),
                    };
                    let fused = Fused {
                        normalisations: is_normalised.then_some(&normalisations),
                        residual: Some(&residual),
                        relu: true,
                    };
                    // What is left of an earlier, larger run must not matter.
                    let mut output = vec![f32::NAN; grid.pixels() * outputs + 100];
                    packed.run(&case.input, grid, fused, &mut output).unwrap();
                    assert_eq!(output.len(), expected.len());
                    let scale = (9 * inputs) as f64;
                    for ((found, sum), residual) in output.iter().zip(expected).zip(&residual) {
                        let error =
                            (f64::from(*found) - (sum + f64::from(*residual)).max(0.0)).abs();
                        assert!(
                            error < tolerance * scale.sqrt(),
                            "{shape:?} {grid:?} {format:?} way {way} normalised {is_normalised}: {error}"
                        );
                    }
                }
            }
        }
    }
}
