use std::iter;

use candle_core::{Device, Tensor};
use wm_zoo::{
    WebDinoConfig,
    idm::{ConvolutionalIdmConfig, IdmNetworkConfig},
};

use super::network::HEAD;
use crate::fresh_weights::FreshWeights;

/// Longest wavelength over the shortest: grids have few rows, and a longer wave would hardly vary over them.
const WAVELENGTHS: f64 = 100.0;

/// Height of the waves that tell the encoder's places. At 1 they would be as large as what patches of a picture hold, and
/// most of what the features tell first.
const HEIGHT: f32 = 0.3;

/// Part of what a block computes that it adds to the tokens.
const BLOCK_SCALE: f64 = 0.1;

/// Gives the encoder and its head those initial values that are not the usual ones.
pub(super) fn begin(
    fresh: &FreshWeights,
    encoder: &WebDinoConfig,
    head: &IdmNetworkConfig,
) -> candle_core::Result<()> {
    begin_as_patches(fresh, encoder)?;
    begin_as_waves(fresh, encoder, head)?;
    match head {
        IdmNetworkConfig::Convolutional(head) => begin_with_differences(fresh, head),
        IdmNetworkConfig::Transformer(_) => Ok(()),
    }
}

/// Has each block add little at first (LayerScale, arXiv 2103.17239), so that features begin close to embedded patches,
/// which the head can compare. Under four whole random blocks, a patch that is lit changes its token by a quarter as much.
fn begin_as_patches(fresh: &FreshWeights, encoder: &WebDinoConfig) -> candle_core::Result<()> {
    let shape = [encoder.hidden_size];
    for layer in 0..encoder.num_hidden_layers {
        for scale in ["layer_scale1", "layer_scale2"] {
            let name = format!("dinov2.encoder.layer.{layer}.{scale}.lambda1");
            fresh.variable(&name, &shape, || fresh.usual(&name, &shape)? * BLOCK_SCALE)?;
        }
    }
    Ok(())
}

/// Has the head's first convolution begin with differences between frames: over the frames, its kernels add up to nothing.
///
/// Most of what the features hold is the same in all frames. Let through, it makes actions that are wrong whatever moves,
/// and what the head learns first is to be silent: its ReLUs close, and the actions stay at their mean.
fn begin_with_differences(
    fresh: &FreshWeights,
    head: &ConvolutionalIdmConfig,
) -> candle_core::Result<()> {
    let frames = head.horizon + 1;
    let name = format!("{HEAD}convs.0.weight");
    let shape = [head.width, frames * head.features, 3, 3];
    fresh.variable(&name, &shape, || {
        let usual = fresh.usual(&name, &shape)?;
        let usual = usual.reshape((head.width, frames, head.features, 3, 3))?;
        let differences = usual.broadcast_sub(&usual.mean_keepdim(1)?)?;
        // As large as they were.
        let size = (frames as f64 / head.horizon as f64).sqrt();
        (differences * size)?.reshape(&shape)
    })?;
    Ok(())
}

/// Has the embeddings of place and time begin as sines and cosines (as the vision transformers of arXiv 2111.06377), and
/// be learned from there. Random ones begin so small beside the pictures that a short training hardly gets past telling
/// that something moved.
fn begin_as_waves(
    fresh: &FreshWeights,
    encoder: &WebDinoConfig,
    head: &IdmNetworkConfig,
) -> candle_core::Result<()> {
    let (width, grid) = (encoder.hidden_size, [encoder.grid(); 2]);
    let low = waves(grid, width).into_iter().map(|value| HEIGHT * value);
    let places: Vec<f32> = iter::repeat_n(0.0, width).chain(low).collect();
    // The first place is that of the CLS token, which has none.
    let shape = [1, places.len() / width, width];
    let name = "dinov2.embeddings.position_embeddings";
    fresh.variable(name, &shape, || {
        Tensor::from_vec(places, &shape, &Device::Cpu)
    })?;
    let IdmNetworkConfig::Transformer(head) = head else {
        return Ok(());
    };
    let ([rows, columns], frames, width) = (head.grid, head.horizon + 1, head.hidden);
    for (name, count, values) in [
        ("spatial_pos_emb", rows * columns, waves(head.grid, width)),
        ("temporal_pos_emb", frames, waves([1, frames], width)),
    ] {
        let initial = || Tensor::from_vec(values, (count, width), &Device::Cpu);
        fresh.variable(&format!("{HEAD}{name}"), &[count, width], initial)?;
    }
    Ok(())
}

/// For each place of a grid, row by row, `width` values: sine and cosine of its row and of its column, at one wavelength
/// after the other.
fn waves([rows, columns]: [usize; 2], width: usize) -> Vec<f32> {
    let mut values = Vec::with_capacity(rows * columns * width);
    for row in 0..rows {
        for column in 0..columns {
            for channel in 0..width {
                let part = (channel / 4) as f64 / (width as f64 / 4.0);
                let frequency = WAVELENGTHS.powf(-part);
                let (at_row, at_column) = (row as f64 * frequency, column as f64 * frequency);
                let value = match channel % 4 {
                    0 => at_row.sin(),
                    1 => at_row.cos(),
                    2 => at_column.sin(),
                    _ => at_column.cos(),
                };
                values.push(value as f32);
            }
        }
    }
    values
}
