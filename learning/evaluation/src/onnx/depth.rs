//! Depth of a single picture.

use image::RgbImage;

use crate::onnx::features::other;
use crate::onnx::field::on_the_picture;
use crate::onnx::input::size_of;
use crate::onnx::{Network, Result, Role};

/// A network for depth: `depth`.
#[derive(Debug)]
pub struct Depth {
    network: Network,
    output: usize,
}

/// One number per pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width \[px\].
    pub width: usize,
    /// Height \[px\].
    pub height: usize,
    /// In the network's unit, row by row; many networks give the inverse depth up to scale and offset.
    pub values: Vec<f32>,
}

impl Depth {
    pub(crate) fn new(network: Network) -> Result<Self> {
        if network.role() != Role::Depth {
            return Err(other(&network, "depth"));
        }
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(1, "pictures")?;
        Ok(Self { network, output })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Depth of a picture, resized (bilinear) to the picture's size.
    pub fn of(&self, picture: &RgbImage) -> Result<DepthMap> {
        let network = &self.network;
        let (input, size) = network.single(picture)?;
        let outputs = network.run(&[input])?;
        let [values] = on_the_picture(network, &outputs, self.output, size, picture)?;
        let [height, width] = size_of(picture);
        Ok(DepthMap {
            width,
            height,
            values,
        })
    }
}
