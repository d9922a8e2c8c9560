//! What computes a loaded model, and where.

use candle_core::{DType, Device, Tensor};

use crate::Result;
use crate::ops::{Engine, PackedFormat};
use crate::transition::{LoadedTransition, PackedTransition, TensorTransition, Transition};

/// What computes a loaded model, and where: the CPU's kernels, or tensor operations on some device.
#[derive(Clone, Debug)]
pub struct Place {
    engine: Engine,
    device: Device,
    recorded: bool,
}

impl Default for Place {
    /// The CPU's kernels.
    fn default() -> Self {
        Self {
            engine: Engine::Cpu,
            device: Device::Cpu,
            recorded: false,
        }
    }
}

impl Place {
    /// Tensor operations on `device`. With `recorded`, passes of few tokens are recorded and repeated, where the device
    /// can: a CUDA graph for each shape. A device that records is for one thread at a time.
    pub fn tensors(device: Device, recorded: bool) -> Self {
        Self {
            engine: Engine::Candle,
            device,
            recorded,
        }
    }

    /// What computes.
    pub fn engine(&self) -> Engine {
        self.engine
    }

    /// Where.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// A tensor of the CPU there, in `format`.
    ///
    /// # Errors
    /// If the device has no memory for it.
    pub fn tensor(&self, tensor: &Tensor, format: DType) -> Result<Tensor> {
        Ok(tensor.to_device(&self.device)?.to_dtype(format)?)
    }

    /// `model`, whose tensors are there, ready for inference; kernels have its weights packed in `format`.
    ///
    /// # Errors
    /// If its tensors cannot be read, or the device has no memory left.
    pub fn load(&self, model: Transition, format: PackedFormat) -> Result<LoadedTransition> {
        Ok(match self.engine {
            Engine::Cpu => PackedTransition::new(&model, format)?.into(),
            Engine::Candle => TensorTransition::new(model, self.recorded)?.into(),
        })
    }
}
