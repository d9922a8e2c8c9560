//! Batches of numbers, where a model computes.

use std::sync::Arc;

use candle_core::{Device, Tensor};

use crate::{Error, Result};

/// Values for a batch of candidates, or for a batch of 1, which all of them share. Clones share the values.
#[derive(Clone, Debug)]
pub(crate) struct Batched {
    batch: usize,
    values: Values,
}

#[derive(Clone, Debug)]
enum Values {
    /// For kernels: (batch, values of each).
    Slice(Arc<[f32]>),
    /// For tensor operations, f32, on the model's device: (batch, values of each).
    Tensor(Tensor),
}

impl Batched {
    /// For the kernels of a packed model.
    pub(crate) fn of_slice(batch: usize, values: impl Into<Arc<[f32]>>) -> Self {
        let values = Values::Slice(values.into());
        Self { batch, values }
    }

    /// A tensor (batch, ..) of f32.
    pub(crate) fn of_tensor(values: &Tensor) -> Result<Self> {
        let batch = values.dim(0)?;
        let values = Values::Tensor(values.reshape((batch, ()))?);
        Ok(Self { batch, values })
    }

    /// How many candidates it is for.
    pub(crate) fn batch(&self) -> usize {
        self.batch
    }

    /// The values, for kernels.
    pub(crate) fn slice(&self) -> Result<&[f32]> {
        match &self.values {
            Values::Slice(values) => Ok(values),
            Values::Tensor(_) => Err(elsewhere("a tensor, expected values for kernels")),
        }
    }

    /// The values (batch, values of each), for tensor operations.
    pub(crate) fn tensor(&self) -> Result<&Tensor> {
        match &self.values {
            Values::Tensor(values) => Ok(values),
            Values::Slice(_) => Err(elsewhere("values for kernels, expected a tensor")),
        }
    }

    /// The values, to be changed by kernels; copied first if they are shared.
    pub(crate) fn slice_mut(&mut self) -> Result<&mut [f32]> {
        match &mut self.values {
            Values::Slice(values) => Ok(Arc::make_mut(values)),
            Values::Tensor(_) => Err(elsewhere("a tensor, expected values for kernels")),
        }
    }

    /// Whether both have the same values for as many candidates.
    pub(crate) fn is_same(&self, other: &Self) -> Result<bool> {
        if self.batch != other.batch {
            return Ok(false);
        }
        Ok(match (&self.values, &other.values) {
            (Values::Slice(a), Values::Slice(b)) => a == b,
            _ => self.to_vec()? == other.to_vec()?,
        })
    }

    /// The values, brought here.
    pub(crate) fn to_vec(&self) -> Result<Vec<f32>> {
        match &self.values {
            Values::Slice(values) => Ok(values.to_vec()),
            Values::Tensor(values) => {
                let values = values.to_device(&Device::Cpu)?;
                Ok(values.flatten_all()?.to_vec1()?)
            }
        }
    }

    /// The values for a batch of `n`.
    pub(crate) fn expanded(&self, n: usize) -> Result<Self> {
        if self.batch == n {
            return Ok(self.clone());
        }
        let values = match &self.values {
            Values::Slice(values) => Values::Slice(values.repeat(n).into()),
            Values::Tensor(values) => {
                let width = values.dim(1)?;
                Values::Tensor(values.broadcast_as((n, width))?.contiguous()?)
            }
        };
        Ok(Self { batch: n, values })
    }
}

/// A model was given what another one holds.
fn elsewhere(reason: &str) -> Error {
    Error::config("engine", reason)
}
