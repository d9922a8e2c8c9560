//! Networks by candle's operations, on any device.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};

use super::{Conv, ConvLayers, GroupNorm};
use crate::{Error, Result};

/// The weights of a network on a device, by their names in checkpoints. Activations are (image, channel, row, column).
#[derive(Clone, Debug)]
pub(crate) struct Tensors {
    device: Device,
    weights: BTreeMap<String, Tensor>,
}

impl Tensors {
    pub(crate) fn new(device: &Device) -> Self {
        Self {
            device: device.clone(),
            weights: BTreeMap::new(),
        }
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Copies a weight to the device.
    pub(crate) fn insert(&mut self, name: String, shape: &[usize], values: &[f32]) -> Result<()> {
        let tensor = Tensor::from_slice(values, shape, &self.device)?;
        self.weights.insert(name, tensor);
        Ok(())
    }

    fn get(&self, name: String) -> Result<&Tensor> {
        let tensor = self.weights.get(&name);
        tensor.ok_or_else(|| Error::config("network", format!("no tensor `{name}`")))
    }

    /// A value of each channel, (1, channel, 1, 1).
    fn channels(&self, name: String) -> Result<Tensor> {
        Ok(self.get(name)?.reshape((1, (), 1, 1))?)
    }
}

impl ConvLayers for &Tensors {
    type Value = Tensor;

    fn conv(&mut self, conv: &Conv, x: &Tensor, residual: Option<&Tensor>) -> Result<Tensor> {
        let (shape, name) = (conv.shape, &conv.name);
        let (_, _, height, width) = x.dims4()?;
        let doubled = match shape.upsample {
            true => Some(x.upsample_nearest2d(2 * height, 2 * width)?),
            false => None,
        };
        let x = doubled.as_ref().unwrap_or(x);
        let weight = self.get(format!("{name}.weight"))?;
        let mut y = x.conv2d(weight, shape.kernel / 2, shape.stride, 1, 1)?;
        if conv.bias.is_some() {
            y = y.broadcast_add(&self.channels(format!("{name}.bias"))?)?;
        }
        if let Some(residual) = residual {
            y = (y + residual)?;
        }
        Ok(if conv.relu { y.relu()? } else { y })
    }

    fn group_norm_relu(&mut self, norm: &GroupNorm, x: Tensor) -> Result<Tensor> {
        let groups = x.reshape((x.dim(0)?, norm.groups, ()))?;
        let centred = groups.broadcast_sub(&groups.mean_keepdim(2)?)?;
        let variance = centred.sqr()?.mean_keepdim(2)?;
        let normed = centred.broadcast_div(&(variance + norm.eps)?.sqrt()?)?;
        let scale = self.channels(format!("{}.weight", norm.name))?;
        let shift = self.channels(format!("{}.bias", norm.name))?;
        let normed = normed.reshape(x.shape())?.broadcast_mul(&scale)?;
        Ok(normed.broadcast_add(&shift)?.relu()?)
    }
}
