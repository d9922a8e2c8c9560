//! How fast this machine convolves, encodes and decodes: the best of some runs, on all threads of rayon
//! (`RAYON_NUM_THREADS` sets how many).
//!
//! ```text
//! cargo run --release -p wm_model --example autoencoder_speed
//! ```

use std::time::Instant;

use candle_core::{DType, Device, Tensor};
use wm_model::ops::{
    ConvShape, Fused, GridSize, PackedConv, conv2d_input_gradient, conv2d_weight_gradient,
};
use wm_model::{Autoencoder, AutoencoderConfig, Decoder as _, Encoder as _, NumberFormat, Result};

/// Seconds of the fastest of some runs.
fn best(mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut best = f64::MAX;
    for _ in 0..9 {
        let start = Instant::now();
        run()?;
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}

fn convolution(name: &str, shape: ConvShape, size: usize) -> Result<()> {
    let grid = GridSize {
        images: 16,
        height: size,
        width: size,
    };
    let input = vec![0.5; grid.pixels() * shape.inputs];
    let gradient = vec![0.5; shape.output(grid).pixels() * shape.outputs];
    let weight = vec![0.1; shape.weights()];
    let mut by_weight = weight.clone();
    let (mut output, mut by_input) = (Vec::new(), vec![0.0; input.len()]);
    let epilogue = Fused {
        normalisations: None,
        residual: None,
        relu: true,
    };
    let packed = PackedConv::new(&shape, &weight, None, NumberFormat::F32)?;
    let forward = best(|| packed.run(&input, grid, epilogue, &mut output).map(drop))?;
    let backward = best(|| {
        conv2d_input_gradient(
            &shape,
            &weight,
            &gradient,
            grid,
            None,
            Some(&input),
            &mut by_input,
        )
    })?;
    let weights =
        best(|| conv2d_weight_gradient(&shape, &input, &gradient, grid, &mut by_weight, None))?;
    let [forward, backward, weights] =
        [forward, backward, weights].map(|time| shape.flops(grid) as f64 / time / 1e9);
    println!("{name:24} at {size:3}: {forward:4.0} {backward:4.0} {weights:4.0}");
    Ok(())
}

fn main() -> Result<()> {
    println!("GFLOP/s on 16 images: forward, gradient by input, by weights");
    convolution("3x3 16 -> 16", ConvShape::same(16, 16, 3), 64)?;
    convolution("3x3 32 -> 32", ConvShape::same(32, 32, 3), 32)?;
    convolution("3x3 64 -> 64", ConvShape::same(64, 64, 3), 64)?;
    convolution("3x3 96 -> 96", ConvShape::same(96, 96, 3), 16)?;
    convolution("3x3 stride 2 32 -> 64", ConvShape::down(32, 64), 32)?;
    convolution("doubled, 3x3 64 -> 32", ConvShape::up(64, 32), 32)?;

    for config in [
        AutoencoderConfig::tiny(),
        AutoencoderConfig::taef2(256, 256),
    ] {
        let name = config.name.clone();
        let model = Autoencoder::random(config, 1)?;
        let (height, width) = model.input_size();
        let image = Tensor::zeros((1, height, width, 3), DType::F32, &Device::Cpu)?;
        let latent = model.encode(&image)?;
        let encode = best(|| model.encode(&image).map(drop))?;
        let decode = best(|| model.decode(&latent).map(drop))?;
        println!(
            "{name}, {height}x{width}: encode {:.1} ms, decode {:.1} ms",
            encode * 1e3,
            decode * 1e3
        );
    }
    Ok(())
}
