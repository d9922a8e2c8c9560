use candle_core::{Device, Tensor};
use wm_zoo::{idm::IdmNetworkConfig, vit::WebDinoConfig};

use super::network::HEAD;
use crate::fresh_weights::FreshWeights;

/// Longest wavelength over the shortest: grids have few rows, and a longer wave would hardly vary over them.
const WAVELENGTHS: f64 = 100.0;

/// Has the embeddings of place and time begin as sines and cosines (as the vision transformers of arXiv 2111.06377), and
/// be learned from there. Random ones begin so small beside the pictures that a short training hardly gets past telling
/// that something moved.
pub(super) fn begin_as_waves(
    fresh: &FreshWeights,
    encoder: &WebDinoConfig,
    head: &IdmNetworkConfig,
) -> candle_core::Result<()> {
    let (width, grid) = (encoder.hidden_size, [encoder.grid(); 2]);
    let places = [vec![0.0; width], waves(grid, width)].concat();
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
