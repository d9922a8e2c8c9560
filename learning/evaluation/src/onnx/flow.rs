//! Optical flow.

use image::RgbImage;

use crate::onnx::features::other;
use crate::onnx::field::on_the_picture;
use crate::onnx::input::size_of;
use crate::onnx::scores::same_size;
use crate::onnx::{Network, Result, Role};

/// A network for optical flow: `flow`.
#[derive(Debug)]
pub struct Flow {
    network: Network,
    output: usize,
}

/// Displacement of each pixel from one picture to the next.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowField {
    /// Width \[px\].
    pub width: usize,
    /// Height \[px\].
    pub height: usize,
    /// Displacement to the right \[px\], row by row.
    pub u: Vec<f32>,
    /// Displacement down \[px\], row by row.
    pub v: Vec<f32>,
}

impl Flow {
    pub(crate) fn new(network: Network) -> Result<Self> {
        if network.role() != Role::Flow {
            return Err(other(&network, "flow"));
        }
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(2, "two pictures")?;
        Ok(Self { network, output })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// The flow from the first picture to the second, of equal size: the displacement of each pixel of the first.
    ///
    /// If the network works on a resized picture, its field is resized back (bilinear) and scaled by the ratio of the
    /// sides, so that displacements are in pixels of the given pictures.
    pub fn between(&self, first: &RgbImage, second: &RgbImage) -> Result<FlowField> {
        let network = &self.network;
        same_size(network, first, second)?;
        let (one, size) = network.single(first)?;
        let (two, _) = network.single(second)?;
        let outputs = network.run(&[one, two])?;
        let [u, v] = on_the_picture(network, &outputs, self.output, size, first)?;
        let ([height, width], [seen_height, seen_width]) = (size_of(first), size);
        let scaled =
            |plane: Vec<f32>, ratio: f32| plane.into_iter().map(|value| value * ratio).collect();
        Ok(FlowField {
            width,
            height,
            u: scaled(u, width as f32 / seen_width as f32),
            v: scaled(v, height as f32 / seen_height as f32),
        })
    }
}
