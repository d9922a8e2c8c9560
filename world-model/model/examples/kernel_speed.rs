//! GFLOP/s of the matrix product and of convolutions at the sizes of the published models, on one thread and on all: of
//! each the best of many runs, which are made in turns, because other guests of a shared machine come and go.
//!
//! ```text
//! cargo run --release -p wm_model --example kernel_speed
//! ```

use std::time::Instant;

use wm_model::ops::{ConvShape, Epilogue, GridSize, PackedConv, PackedFormat, PackedLinear};
use wm_model::{Error, Result};

/// (rows, inputs, outputs).
const LINEAR: [(usize, usize, usize); 6] = [
    (256, 256, 4096),
    (256, 384, 1536),
    (256, 1008, 256),
    (256, 1024, 4096),
    (256, 4096, 1024),
    (2048, 2048, 2048),
];
/// (channels, side).
const CONVOLUTIONS: [(usize, usize); 4] = [(512, 32), (512, 64), (256, 128), (128, 256)];
const ROUNDS: usize = 12;

/// Something to time: its name and operations.
struct Case {
    name: String,
    operations: usize,
    run: Box<dyn FnMut() + Send>,
    best: f64,
}

fn linear((rows, inputs, outputs): (usize, usize, usize)) -> Result<Case> {
    let weight = vec![0.1; inputs * outputs];
    let linear = PackedLinear::new(&weight, None, (outputs, inputs), PackedFormat::F32)?;
    let (x, mut y) = (vec![0.5; rows * inputs], vec![0.0; rows * outputs]);
    Ok(Case {
        name: format!("linear {rows} x {inputs} -> {outputs}"),
        operations: 2 * rows * inputs * outputs,
        run: Box::new(move || linear.forward_on_pool(&x, &mut y)),
        best: 0.0,
    })
}

fn convolution((channels, side): (usize, usize)) -> Result<Case> {
    let shape = ConvShape::same(channels, channels, 3);
    let grid = GridSize {
        images: 1,
        height: side,
        width: side,
    };
    let packed = PackedConv::new(&shape, &vec![0.1; shape.weights()], None)?;
    let (input, mut output) = (vec![0.5; grid.pixels() * channels], Vec::new());
    let epilogue = Epilogue {
        residual: None,
        relu: false,
    };
    Ok(Case {
        name: format!("convolution 3x3 {channels} at {side}"),
        operations: shape.flops(grid),
        run: Box::new(move || {
            packed.run(&input, grid, epilogue, &mut output).ok();
        }),
        best: 0.0,
    })
}

fn main() -> Result<()> {
    let linear = LINEAR.into_iter().map(linear);
    let mut cases: Vec<Case> = linear
        .chain(CONVOLUTIONS.into_iter().map(convolution))
        .collect::<Result<_>>()?;
    for threads in [1, rayon::current_num_threads()] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.map_err(|error| Error::config("threads", error.to_string()))?
            .install(|| {
                for _ in 0..ROUNDS {
                    for case in &mut cases {
                        let start = Instant::now();
                        (case.run)();
                        let rate = case.operations as f64 / start.elapsed().as_secs_f64() / 1e9;
                        case.best = case.best.max(rate);
                    }
                }
            });
        println!("{threads} threads, GFLOP/s");
        for case in &mut cases {
            println!("  {:<28}{:4.0}", case.name, case.best);
            case.best = 0.0;
        }
    }
    Ok(())
}
