//! Input tensors by name.

use candle_core::{DType, Device, Tensor};

use super::Tensors;
use crate::{Error, Result};

/// The tensors that a model is given. They are checked where they are, and then moved to the model's device.
pub(super) struct Inputs<'a> {
    /// Of which model, for errors.
    kind: &'static str,
    tensors: &'a Tensors,
    device: &'a Device,
}

impl<'a> Inputs<'a> {
    pub(super) fn new(kind: &'static str, tensors: &'a Tensors, device: &'a Device) -> Self {
        Self {
            kind,
            tensors,
            device,
        }
    }

    /// The tensor `name` as f32, checked to have values, all of them finite.
    pub(super) fn float(&self, name: &str) -> Result<Tensor> {
        self.optional_float(name)?.ok_or_else(|| self.missing(name))
    }

    /// As [`Inputs::float`], if there is such a tensor.
    pub(super) fn optional_float(&self, name: &str) -> Result<Option<Tensor>> {
        let tensor = self.checked(name)?;
        Ok(tensor.map(|x| x.to_device(self.device)).transpose()?)
    }

    /// As [`Inputs::optional_float`], where the tensor is.
    fn checked(&self, name: &str) -> Result<Option<Tensor>> {
        let Some(tensor) = self.tensors.get(name) else {
            return Ok(None);
        };
        check_not_empty(name, tensor)?;
        let tensor = tensor.to_dtype(DType::F32)?.contiguous()?;
        if !is_finite(&tensor)? {
            return Err(input(format!("`{name}` has a value that is not finite")));
        }
        Ok(Some(tensor))
    }

    /// As [`Inputs::float`], with values from 0 to 1.
    pub(super) fn unit(&self, name: &str) -> Result<Tensor> {
        let tensor = self.checked(name)?.ok_or_else(|| self.missing(name))?;
        let values = tensor.flatten_all()?;
        for end in [values.min(0)?, values.max(0)?] {
            let value = end.to_scalar::<f32>()?;
            if !(0.0..=1.0).contains(&value) {
                return Err(input(format!(
                    "`{name}` has a value {value}, expected 0 to 1"
                )));
            }
        }
        Ok(tensor.to_device(self.device)?)
    }

    /// The tensor `name`, which must hold integers, as 64-bit ones.
    pub(super) fn integers(&self, name: &str) -> Result<Tensor> {
        let tensor = self.tensors.get(name).ok_or_else(|| self.missing(name))?;
        check_not_empty(name, tensor)?;
        if tensor.dtype().is_float() {
            let reason = format!("`{name}` is {:?}, expected integers", tensor.dtype());
            return Err(input(reason));
        }
        let tensor = tensor.to_dtype(DType::I64)?.contiguous()?;
        Ok(tensor.to_device(self.device)?)
    }

    fn missing(&self, name: &str) -> Error {
        let found: Vec<&str> = self.tensors.keys().map(String::as_str).collect();
        input(format!(
            "kind {} takes a tensor `{name}`; there are: {}",
            self.kind,
            found.join(", ")
        ))
    }
}

fn input(reason: String) -> Error {
    wm_model::Error::config("input", reason).into()
}

fn check_not_empty(name: &str, tensor: &Tensor) -> Result<()> {
    match tensor.elem_count() {
        0 => Err(input(format!(
            "`{name}` of shape {:?} is empty",
            tensor.dims()
        ))),
        _ => Ok(()),
    }
}

/// Whether no value of `tensor`, which is f32, is NaN or infinite.
pub(super) fn is_finite(tensor: &Tensor) -> Result<bool> {
    // Times zero a finite value is 0 and any other NaN, which a sum keeps.
    let sum = (tensor.flatten_all()? * 0.0)?.sum_all()?;
    Ok(sum.to_scalar::<f32>()? == 0.0)
}
