//! Input tensors by name.

use candle_core::{DType, Tensor};

use super::Tensors;
use crate::{Error, Result};

/// The tensors that a model is given.
pub(super) struct Inputs<'a> {
    /// Of which model, for errors.
    kind: &'static str,
    tensors: &'a Tensors,
}

impl<'a> Inputs<'a> {
    pub(super) fn new(kind: &'static str, tensors: &'a Tensors) -> Self {
        Self { kind, tensors }
    }

    /// The tensor `name` as f32.
    pub(super) fn float(&self, name: &str) -> Result<Tensor> {
        self.optional_float(name)?.ok_or_else(|| self.missing(name))
    }

    /// The tensor `name` as f32, if there is one.
    pub(super) fn optional_float(&self, name: &str) -> Result<Option<Tensor>> {
        let tensor = self.tensors.get(name);
        Ok(tensor
            .map(|tensor| tensor.to_dtype(DType::F32)?.contiguous())
            .transpose()?)
    }

    /// The tensor `name`, which must hold integers.
    pub(super) fn integers(&self, name: &str) -> Result<Tensor> {
        let tensor = self.tensors.get(name).ok_or_else(|| self.missing(name))?;
        if tensor.dtype().is_float() {
            let reason = format!("`{name}` is {:?}, expected integers", tensor.dtype());
            return Err(wm_model::Error::config("input", reason).into());
        }
        Ok(tensor.contiguous()?)
    }

    fn missing(&self, name: &str) -> Error {
        let found: Vec<&str> = self.tensors.keys().map(String::as_str).collect();
        let reason = format!(
            "kind {} takes a tensor `{name}`; there are: {}",
            self.kind,
            found.join(", ")
        );
        wm_model::Error::config("input", reason).into()
    }
}
