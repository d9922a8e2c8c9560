//! Pictures to tokens.

use candle_core::{DType, Device, Tensor};

use crate::Result;
use crate::layers::Linear;
use crate::loader::Loader;
use crate::sizes::shape_error;

/// The convolution whose kernel is its stride, as a product of patches and filters.
#[derive(Clone, Debug)]
pub(crate) struct PatchEmbedding {
    patch: usize,
    /// From the values of a patch, in the order row, column, channel.
    filters: Linear,
    dtype: DType,
    device: Device,
}

impl PatchEmbedding {
    /// Loads `name.weight` (width, 3, [1,] patch, patch) and `name.bias` (width).
    ///
    /// `frames` tells that the stored convolution is three-dimensional, over that many frames;
    /// only one frame can be embedded.
    pub(crate) fn load(
        loader: &Loader<'_>,
        name: &str,
        (width, patch): (usize, usize),
        frames: Option<usize>,
    ) -> Result<Self> {
        let mut shape = vec![width, 3];
        shape.extend(frames);
        shape.extend([patch, patch]);
        let weight = loader.tensor(&format!("{name}.weight"), &shape)?;
        let bias = loader.tensor(&format!("{name}.bias"), &[width])?;
        // A filter without frames sees one.
        let inputs = frames.unwrap_or(1) * patch * patch;
        let channels_last = weight.reshape((width, 3, inputs))?.transpose(1, 2)?;
        let weight = channels_last.contiguous()?.reshape((width, inputs * 3))?;
        Ok(Self {
            patch,
            dtype: weight.dtype(),
            device: weight.device().clone(),
            filters: Linear::new(weight, Some(bias), loader.kernels(), loader.format())?,
        })
    }

    /// The number format that tokens come in.
    pub(crate) fn dtype(&self) -> DType {
        self.dtype
    }

    /// `image` (N, H, W, 3) to tokens (N, H / patch * W / patch, width), row by row.
    pub(crate) fn forward(&self, image: &Tensor) -> Result<Tensor> {
        let p = self.patch;
        let &[n, height, width, 3] = image.dims() else {
            return Err(shape_error("the image", "(N, H, W, 3)", image));
        };
        if !height.is_multiple_of(p) || !width.is_multiple_of(p) {
            let expected = format!("(N, H, W, 3) with H and W multiples of {p}");
            return Err(shape_error("the image", expected, image));
        }
        let (rows, columns) = (height / p, width / p);
        let patches = image
            .to_device(&self.device)?
            .to_dtype(self.dtype)?
            .reshape((n * rows, p, columns, p * 3))?
            .transpose(1, 2)?
            .contiguous()?
            .reshape((n, rows * columns, p * p * 3))?;
        self.filters.forward(&patches)
    }
}
