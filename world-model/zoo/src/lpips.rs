//! LPIPS: the learned perceptual distance of two pictures, with AlexNet.
//!
//! Paper: "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric" (arXiv 1801.03924), version 0.1;
//! checkpoints: torchvision's AlexNet (`alexnet-owt-7be5be79.pth`) and the linear heads of the package `lpips`
//! (`weights/v0.1/alex.pth`). Gradients reach both pictures.
//!
//! Names: `features.{0,3,6,8,10}.{weight,bias}` of AlexNet, what else the file has is passed over;
//! `lin{0..4}.model.1.weight` of the heads.

use std::path::Path;

use candle_core::{DType, Device, Tensor};

use crate::{Checkpoint, Error, Misshapen, Result};

/// What the scaling layer of LPIPS v0.1 subtracts from each colour of pictures in -1..1, and divides by.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Index in torchvision's `features`, kernel, stride and border of AlexNet's convolutions.
const CONVOLUTIONS: [(usize, usize, usize, usize); 5] = [
    (0, 11, 4, 2),
    (3, 5, 1, 2),
    (6, 3, 1, 1),
    (8, 3, 1, 1),
    (10, 3, 1, 1),
];
/// Convolutions that are followed by pooling, by their order.
const POOLED: [bool; 5] = [true, true, false, false, false];
/// Added to the lengths of features, and under the root of them, whose slope is infinite at 0.
const TINY: f64 = 1e-10;

/// The learned perceptual distance LPIPS v0.1 (Zhang et al. 2018) with AlexNet, whose weights the user supplies.
#[derive(Debug)]
pub struct Lpips {
    layers: Vec<Layer>,
}

#[derive(Debug)]
struct Layer {
    kernel: usize,
    stride: usize,
    border: usize,
    /// (kernel kernel inputs, outputs).
    weight: Tensor,
    bias: Tensor,
    /// Weight of each channel's squared difference: (outputs).
    head: Tensor,
    pools: bool,
}

impl Lpips {
    /// Opens AlexNet and the linear heads, safetensors or torch files.
    ///
    /// # Errors
    /// If a tensor is missing or of another shape.
    pub fn open(trunk: &Path, heads: &Path) -> Result<Self> {
        Self::load(&Checkpoint::open(trunk)?, &Checkpoint::open(heads)?)
    }

    /// The same, of files that are open.
    ///
    /// # Errors
    /// If a tensor is missing or of another shape.
    pub fn load(trunk: &Checkpoint, heads: &Checkpoint) -> Result<Self> {
        let mut inputs = 3;
        let mut layers = Vec::with_capacity(CONVOLUTIONS.len());
        for (order, ((index, kernel, stride, border), pools)) in
            CONVOLUTIONS.into_iter().zip(POOLED).enumerate()
        {
            let name = format!("features.{index}.weight");
            let found = trunk.shape(&name);
            // A missing tensor is an error of `tensor`.
            let outputs = found.and_then(|shape| shape.first().copied()).unwrap_or(0);
            let expected = [outputs, inputs, kernel, kernel];
            let weight = tensor(trunk, &name, &expected)?;
            let weight = weight.permute((2, 3, 1, 0))?.contiguous()?;
            let head = format!("lin{order}.model.1.weight");
            layers.push(Layer {
                kernel,
                stride,
                border,
                weight: weight.reshape((kernel * kernel * inputs, outputs))?,
                bias: tensor(trunk, &format!("features.{index}.bias"), &[outputs])?,
                head: tensor(heads, &head, &[1, outputs, 1, 1])?.reshape(outputs)?,
                pools,
            });
            inputs = outputs;
        }
        Ok(Self { layers })
    }

    /// The same, for pictures on `device`.
    ///
    /// # Errors
    /// If the networks do not fit there.
    pub fn on(mut self, device: &Device) -> Result<Self> {
        for layer in &mut self.layers {
            for tensor in [&mut layer.weight, &mut layer.bias, &mut layer.head] {
                *tensor = tensor.to_device(device)?;
            }
        }
        Ok(self)
    }

    /// The mean distance of the pictures `a` and `b` (N, H, W, 3) in 0..1: a scalar. Gradients reach both.
    ///
    /// # Errors
    /// If they have another shape, or are too small for the network.
    pub fn distance(&self, a: &Tensor, b: &Tensor) -> Result<Tensor> {
        let (mut a, mut b) = (scaled(a)?, scaled(b)?);
        let mut total = Tensor::zeros((), DType::F32, a.device())?;
        for layer in &self.layers {
            (a, b) = (layer.forward(&a)?, layer.forward(&b)?);
            let difference = (unit(&a)? - unit(&b)?)?.sqr()?;
            let weighted = difference.broadcast_mul(&layer.head)?.sum(3)?;
            total = (total + weighted.mean_all()?)?;
            if layer.pools {
                (a, b) = (pooled(&a)?, pooled(&b)?);
            }
        }
        Ok(total)
    }
}

impl Layer {
    /// Convolution and ReLU, (N, H, W, C).
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let x = x.pad_with_zeros(1, self.border, self.border)?;
        let x = x.pad_with_zeros(2, self.border, self.border)?;
        let (n, height, width, channels) = x.dims4()?;
        let on = x.device();
        let (rows, h) = taps(height, self.kernel, self.stride, on)?;
        let (columns, w) = taps(width, self.kernel, self.stride, on)?;
        let k = self.kernel;
        // Every place with what the kernel sees there.
        let patches = x
            .contiguous()?
            .index_select(&rows, 1)?
            .index_select(&columns, 2)?
            .reshape((n, h, k, w, k * channels))?
            .transpose(2, 3)?
            .contiguous()?
            .reshape((n * h * w, k * k * channels))?;
        let y = patches.matmul(&self.weight)?.broadcast_add(&self.bias)?;
        Ok(y.relu()?.reshape((n, h, w, ()))?)
    }
}

/// For every position of a window along a side, the places that it covers; and how many positions there are.
fn taps(side: usize, window: usize, stride: usize, device: &Device) -> Result<(Tensor, usize)> {
    require_side(side, window)?;
    let positions = (side - window) / stride + 1;
    let places = (0..positions).flat_map(|position| {
        let first = position * stride;
        first..first + window
    });
    let places: Vec<u32> = places.map(|place| place as u32).collect();
    Ok((Tensor::new(places, device)?, positions))
}

/// The largest of 3x3 places, two apart. (candle's own has no gradient where windows overlap.)
fn pooled(x: &Tensor) -> Result<Tensor> {
    let mut x = x.clone();
    for axis in [1, 2] {
        let side = x.dim(axis)?;
        require_side(side, 3)?;
        let positions = (side - 3) / 2 + 1;
        let part = |tap: usize| -> Result<Tensor> {
            let places: Vec<u32> = (0..positions).map(|at| (2 * at + tap) as u32).collect();
            Ok(x.index_select(&Tensor::new(places, x.device())?, axis)?)
        };
        x = part(0)?.maximum(&part(1)?)?.maximum(&part(2)?)?;
    }
    Ok(x)
}

fn scaled(x: &Tensor) -> Result<Tensor> {
    let (shift, scale) = (
        Tensor::new(&SHIFT, x.device())?,
        Tensor::new(&SCALE, x.device())?,
    );
    let signed = x.affine(2.0, -1.0)?;
    Ok(signed.broadcast_sub(&shift)?.broadcast_div(&scale)?)
}

/// Every place's features divided by their length.
fn unit(x: &Tensor) -> Result<Tensor> {
    let length = (x.sqr()?.sum_keepdim(3)? + TINY * TINY)?.sqrt()?;
    Ok(x.broadcast_div(&(length + TINY)?)?)
}

fn require_side(side: usize, window: usize) -> Result<()> {
    if side >= window {
        return Ok(());
    }
    let error = wm_model::Error::Shape {
        what: "side of a layer of LPIPS, whose pictures are too small",
        expected: format!("at least {window}"),
        found: vec![side],
    };
    Err(error.into())
}

fn tensor(checkpoint: &Checkpoint, name: &str, expected: &[usize]) -> Result<Tensor> {
    let (mut missing, mut misshapen) = (Vec::new(), Vec::new());
    match checkpoint.shape(name) {
        Some(found) if found == expected => return checkpoint.tensor(name, DType::F32),
        Some(found) => misshapen.push(Misshapen {
            name: name.to_owned(),
            expected: expected.to_vec(),
            found: found.to_vec(),
        }),
        None => missing.push(name.to_owned()),
    }
    Err(Error::Tensors {
        file: checkpoint.file().to_owned(),
        missing,
        misshapen,
        unexpected: Vec::new(),
    })
}

#[cfg(test)]
mod tests;
