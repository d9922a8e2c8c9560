//! Outputs with one or two numbers per pixel.

use image::RgbImage;

use crate::onnx::input::size_of;
use crate::onnx::resample::resized;
use crate::onnx::{Network, Resize, Result, Tensor};

impl Network {
    /// One picture as input, repeated if the file fixes a larger batch, with its height and width for the network.
    pub(crate) fn single(&self, picture: &RgbImage) -> Result<(Tensor, [usize; 2])> {
        let prepared = self.prepare(picture)?;
        let size = prepared.size;
        // A free batch axis takes one picture.
        let pictures = vec![prepared; self.fixed_batch().unwrap_or(1).max(1)];
        Ok((self.arrange(&pictures, None)?, size))
    }
}

/// The first entry of an output, by plane, resized from `size` (the network's picture) to the picture's own size. Shrinking
/// averages.
pub(crate) fn on_the_picture<const PLANES: usize>(
    network: &Network,
    outputs: &[Tensor],
    output: usize,
    size: [usize; 2],
    picture: &RgbImage,
) -> Result<[Vec<f32>; PLANES]> {
    let [height, width] = size;
    let found = outputs.get(output);
    let shape = found.map_or(&[][..], Tensor::shape);
    let fits = match shape {
        [_, c, h, w] => [*c, *h, *w] == [PLANES, height, width],
        [_, h, w] => PLANES == 1 && [*h, *w] == size,
        _ => false,
    };
    let to = size_of(picture);
    let back = |plane: &[f32]| {
        if to == size {
            plane.to_vec()
        } else {
            resized(plane, size, to, 1, (Resize::Bilinear, true))
        }
    };
    found
        .filter(|_| fits)
        .and_then(|tensor| {
            let first = tensor.rows().next()?;
            let planes: Vec<_> = first
                .chunks_exact((height * width).max(1))
                .map(back)
                .collect();
            planes.try_into().ok()
        })
        .ok_or_else(|| {
            let expected = format!("[batch, {PLANES}, {height}, {width}]");
            network.shape_error("output", expected, format!("{shape:?}"))
        })
}
