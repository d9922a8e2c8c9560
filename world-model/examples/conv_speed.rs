//! Prints how fast the convolutions of this machine are.

use std::time::Instant;

use wm_model::ops::{
    ConvShape, Epilogue, GridSize, conv2d, conv2d_input_gradient, conv2d_weight_gradient,
};

fn main() -> wm_model::Result<()> {
    let cases = [
        (ConvShape::same(16, 16, 3), 64),
        (ConvShape::same(32, 32, 3), 32),
        (ConvShape::same(64, 64, 3), 16),
        (ConvShape::same(64, 64, 3), 64),
        (ConvShape::same(96, 96, 3), 16),
        (ConvShape::down(32, 64), 32),
        (ConvShape::up(64, 32), 32),
        (ConvShape::same(16, 3, 3), 64),
    ];
    println!("GFLOP/s: forward, input gradient, weight gradient");
    for (shape, size) in cases {
        let grid = GridSize {
            images: 16,
            height: size,
            width: size,
        };
        let out = shape.output(grid);
        let x = vec![0.5f32; grid.pixels() * shape.inputs];
        let g = vec![0.5f32; out.pixels() * shape.outputs];
        let w = vec![0.1f32; shape.weights()];
        let mut gw = w.clone();
        let (mut y, mut gx) = (Vec::new(), Vec::new());
        let time = |f: &mut dyn FnMut() -> wm_model::Result<()>| -> wm_model::Result<f64> {
            let mut best = f64::MAX;
            for _ in 0..7 {
                let start = Instant::now();
                f()?;
                best = best.min(start.elapsed().as_secs_f64());
            }
            Ok(shape.flops(grid) as f64 / best / 1e9)
        };
        let a = time(&mut || {
            conv2d(
                &shape,
                (&w, None),
                &x,
                grid,
                Epilogue {
                    residual: None,
                    relu: true,
                },
                &mut y,
            )
            .map(drop)
        })?;
        let b = time(&mut || conv2d_input_gradient(&shape, &w, &g, grid, None, Some(&x), &mut gx))?;
        let c = time(&mut || conv2d_weight_gradient(&shape, &x, &g, grid, &mut gw, None))?;
        println!("{shape:?} at {size}: {a:.0} {b:.0} {c:.0}");
    }
    Ok(())
}
