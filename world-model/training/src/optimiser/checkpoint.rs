use std::{collections::HashMap, path::Path};

use candle_core::{Device, Tensor};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::{AdamW, OptimiserError, Parameter};

/// The buffers of one parameter, under the prefixes that they are stored with.
fn buffers(parameter: &mut Parameter) -> [(&'static str, &mut Vec<f32>); 4] {
    [
        ("weights", &mut parameter.weights),
        ("ema", &mut parameter.ema),
        ("first_moment", &mut parameter.first_moment),
        ("second_moment", &mut parameter.second_moment),
    ]
}

impl AdamW {
    /// Writes the whole state to a safetensors file; `run` says what is being trained (settings, data), so that
    /// another run does not resume from it. The file is replaced in one move: a kill leaves the old or the new one.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&mut self, path: &Path, run: &str) -> Result<(), OptimiserError> {
        let mut tensors: Vec<(String, Tensor)> = Vec::new();
        for parameter in &mut self.parameters {
            let shape = parameter.var.shape().clone();
            let name = parameter.name.clone();
            for (prefix, buffer) in buffers(parameter) {
                let tensor = Tensor::from_slice(buffer, shape.clone(), &Device::Cpu)?;
                tensors.push((format!("{prefix}/{name}"), tensor));
            }
        }
        let metadata = HashMap::from([
            ("step".to_owned(), self.step.to_string()),
            ("run".to_owned(), run.to_owned()),
        ]);
        let partial = path.with_extension("partial");
        safetensors::serialize_to_file(tensors, Some(metadata), &partial)
            .map_err(|error| refused(path, error))?;
        std::fs::rename(&partial, path).map_err(|error| refused(path, error))
    }

    /// Takes up the state that [`Self::save`] wrote for the same `run`.
    ///
    /// # Errors
    /// When the file cannot be read, is of another run, or lacks a parameter or has it in another shape.
    pub fn resume(&mut self, path: &Path, run: &str) -> Result<(), OptimiserError> {
        let bytes = std::fs::read(path).map_err(|error| refused(path, error))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| refused(path, error))?;
        let (_, metadata) =
            SafeTensors::read_metadata(&bytes).map_err(|error| refused(path, error))?;
        let entry = |key: &str| {
            metadata
                .metadata()
                .as_ref()
                .and_then(|entries| entries.get(key))
                .ok_or_else(|| refused(path, format!("metadata entry `{key}` is missing")))
        };
        let saved_run = entry("run")?;
        if saved_run != run {
            return Err(refused(
                path,
                format!("expected run {run:?}, found {saved_run:?}"),
            ));
        }
        let step = entry("step")?
            .parse()
            .map_err(|error| refused(path, format!("metadata entry `step`: {error}")))?;
        for parameter in &mut self.parameters {
            let shape = parameter.var.dims().to_vec();
            let name = parameter.name.clone();
            for (prefix, buffer) in buffers(parameter) {
                let tensor = file.tensor(&format!("{prefix}/{name}")).map_err(|_| {
                    refused(path, format!("{prefix} of parameter `{name}` are missing"))
                })?;
                *buffer = f32_values(&tensor, &shape).ok_or_else(|| {
                    refused(
                        path,
                        format!(
                            "{prefix} of parameter `{name}`: expected f32 {shape:?}, found {:?} {:?}",
                            tensor.dtype(),
                            tensor.shape()
                        ),
                    )
                })?;
            }
        }
        self.step = step;
        self.write_back()
    }
}

fn f32_values(tensor: &TensorView<'_>, shape: &[usize]) -> Option<Vec<f32>> {
    (tensor.dtype() == Dtype::F32 && tensor.shape() == shape).then(|| {
        tensor
            .data()
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
            .collect()
    })
}

fn refused(path: &Path, what: impl ToString) -> OptimiserError {
    OptimiserError::Checkpoint {
        path: path.display().to_string(),
        what: what.to_string(),
    }
}
