//! How near to the processor's peak the matrix product and the convolution come, at the sizes of the published models.
//!
//! ```text
//! cargo run --release -p wm_model --example kernel_speed -- [THREADS [peaks]]
//! ```
//!
//! The peaks are measured first: multiply-adds of f32, of pairs of bf16 where the processor has them, and of bytes, of
//! registers only. Then, unless only `peaks` are asked for, every product in f32, bf16 and int8, every convolution in f32 and
//! bf16, and the product of the crate `gemm` in f32: billions of operations a second and the share of the peak. Of each the
//! best of many runs, which are made in turns, because other guests of a shared machine come and go.

use std::hint::black_box;
use std::time::Instant;

use gemm::Parallelism;
use wm_model::ops::{ConvShape, Fused, GridSize, PackedConv, PackedLinear, peak_rate};
use wm_model::{Error, NumberFormat, Result};

/// (rows, inputs, outputs): of DiT-S, the pixel decoder, ViT-L, and a square.
const LINEAR: [(usize, usize, usize); 9] = [
    (128, 384, 1152),
    (128, 384, 2048),
    (128, 1024, 384),
    (256, 256, 4096),
    (256, 1008, 256),
    (257, 1024, 3072),
    (257, 1024, 4096),
    (257, 4096, 1024),
    (2048, 2048, 2048),
];
/// (channels, side): of the convolutional encoders and decoders.
const CONVOLUTIONS: [(usize, usize); 4] = [(512, 32), (512, 64), (256, 128), (128, 256)];
const FORMATS: [(&str, NumberFormat); 3] = [
    ("f32", NumberFormat::F32),
    ("bf16", NumberFormat::Bf16),
    ("int8", NumberFormat::Int8),
];
const ROUNDS: usize = 12;

/// Something to time: its name, its format and its operations.
struct Case {
    name: String,
    format: &'static str,
    operations: usize,
    run: Box<dyn FnMut() + Send>,
    best: f64,
}

impl Case {
    fn new(
        name: String,
        format: &'static str,
        operations: usize,
        run: impl FnMut() + Send + 'static,
    ) -> Self {
        Self {
            name,
            format,
            operations,
            run: Box::new(run),
            best: 0.0,
        }
    }
}

fn linear((rows, inputs, outputs): (usize, usize, usize)) -> Result<Vec<Case>> {
    let name = format!("product {rows} x {inputs} x {outputs}");
    let operations = 2 * rows * inputs * outputs;
    let weight = vec![0.1; inputs * outputs];
    let (x, y) = (vec![0.5; rows * inputs], vec![0.0; rows * outputs]);
    let mut cases = Vec::new();
    for (format, packed) in FORMATS {
        let linear = PackedLinear::new(&weight, None, (outputs, inputs), packed)?;
        let (x, mut y) = (x.clone(), y.clone());
        cases.push(Case::new(name.clone(), format, operations, move || {
            linear.forward_on_pool(&x, &mut y);
        }));
    }
    let mut y = y;
    cases.push(Case::new(name, "f32, gemm", operations, move || {
        let parallelism = match rayon::current_num_threads() {
            1 => Parallelism::None,
            threads => Parallelism::Rayon(threads),
        };
        let (m, k, n) = (rows as isize, inputs as isize, outputs as isize);
        // SAFETY: `y` is m x n, `x` m x k row by row, and the weight n x k row by row, read as its transpose.
        unsafe {
            gemm::gemm(
                rows,
                outputs,
                inputs,
                y.as_mut_ptr(),
                1,
                n,
                false,
                x.as_ptr(),
                1,
                k,
                weight.as_ptr(),
                k,
                1,
                0.0,
                1.0,
                false,
                false,
                false,
                parallelism,
            );
        }
        black_box(m);
    }));
    Ok(cases)
}

fn convolution((channels, side): (usize, usize)) -> Result<Vec<Case>> {
    let shape = ConvShape::same(channels, channels, 3);
    let grid = GridSize {
        images: 1,
        height: side,
        width: side,
    };
    let weight = vec![0.1; shape.weights()];
    let mut cases = Vec::new();
    for (format, packed) in FORMATS {
        // There is none of bytes.
        if packed == NumberFormat::Int8 {
            continue;
        }
        let packed = PackedConv::for_inference(&shape, &weight, None, packed)?;
        let (input, mut output) = (vec![0.5; grid.pixels() * channels], Vec::new());
        let name = format!("3x3 convolution {channels} at {side} x {side}");
        cases.push(Case::new(name, format, shape.flops(grid), move || {
            packed.run(&input, grid, Fused::default(), &mut output).ok();
        }));
    }
    Ok(cases)
}

fn main() -> Result<()> {
    let threads = match std::env::args().nth(1).map(|threads| threads.parse()) {
        None => rayon::current_num_threads(),
        Some(Ok(threads)) => threads,
        Some(Err(error)) => return Err(Error::config("threads", format!("{error}"))),
    };
    let only_peaks = std::env::args().nth(2).is_some_and(|word| word == "peaks");
    let mut cases = Vec::new();
    let mut peaks = FORMATS.map(|(_, packed)| (packed, 0.0));
    if !only_peaks {
        for shape in LINEAR {
            cases.extend(linear(shape)?);
        }
        for shape in CONVOLUTIONS {
            cases.extend(convolution(shape)?);
        }
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|error| Error::config("threads", error.to_string()))?
        .install(|| {
            for _ in 0..ROUNDS {
                for (format, best) in &mut peaks {
                    let rates = rayon::broadcast(|_| peak_rate(*format).unwrap_or_default());
                    *best = rates.iter().sum::<f64>().max(*best);
                }
                for case in &mut cases {
                    let start = Instant::now();
                    (case.run)();
                    let rate = case.operations as f64 / start.elapsed().as_secs_f64() / 1e9;
                    case.best = case.best.max(rate);
                }
            }
        });
    println!("{threads} threads");
    println!("| what | format | Gop/s | of the peak |");
    println!("|---|---|---|---|");
    for ((_, peak), (format, _)) in peaks.iter().zip(FORMATS) {
        println!("| peak | {format} | {:.0} | |", peak / 1e9);
    }
    for case in &cases {
        let peak = peaks
            .iter()
            .zip(FORMATS)
            .find(|(_, (format, _))| case.format == *format);
        let share = match peak {
            Some(((_, peak), _)) if *peak > 0.0 => format!("{:.2}", case.best * 1e9 / peak),
            _ => "-".to_owned(),
        };
        println!(
            "| {} | {} | {:.0} | {share} |",
            case.name, case.format, case.best
        );
    }
    Ok(())
}
