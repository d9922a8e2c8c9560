use std::{
    collections::{BTreeSet, HashMap},
    path::Path,
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{AdamW, OptimiserError, State};

/// Metadata key of a checkpoint.
const METADATA_KEY: &str = "training";

/// Metadata of a checkpoint.
#[derive(Serialize, Deserialize)]
struct CheckpointMetadata {
    step: u64,
    skipped: u64,
    run: Value,
}

/// Buffers of one parameter, with the prefixes of their names.
fn buffers(parameter: &mut State) -> [(&'static str, &mut Vec<f32>); 4] {
    [
        ("weights", &mut parameter.weights),
        ("ema", &mut parameter.ema),
        ("first_moment", &mut parameter.first_moment),
        ("second_moment", &mut parameter.second_moment),
    ]
}

impl AdamW {
    /// Writes the whole state to a safetensors file. `run` describes the training (settings, data), so that others do not
    /// resume from it. The file is replaced atomically.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&mut self, path: &Path, run: &Value) -> Result<(), OptimiserError> {
        let mut tensors = Vec::new();
        for parameter in &mut self.parameters {
            let (shape, name) = (parameter.shape.clone(), parameter.name.clone());
            for (prefix, buffer) in buffers(parameter) {
                let bytes: &[u8] = bytemuck::cast_slice(buffer);
                let view = TensorView::new(Dtype::F32, shape.clone(), bytes)
                    .map_err(|error| refused(path, error))?;
                tensors.push((format!("{prefix}/{name}"), view));
            }
        }
        // A single entry: several would vary in order between files.
        let metadata = CheckpointMetadata {
            step: self.step,
            skipped: self.skipped,
            run: run.clone(),
        };
        let metadata = serde_json::to_string(&metadata).map_err(|error| refused(path, error))?;
        let metadata = HashMap::from([(METADATA_KEY.to_owned(), metadata)]);
        let partial = path.with_extension("partial");
        safetensors::serialize_to_file(tensors, Some(metadata), &partial)
            .map_err(|error| refused(path, error))?;
        std::fs::rename(&partial, path).map_err(|error| refused(path, error))
    }

    /// Restores the state that [`Self::save`] wrote for the same `run`.
    ///
    /// # Errors
    /// If the file cannot be read, belongs to another training (the differences are named), or lacks a parameter of this
    /// shape.
    pub fn resume(&mut self, path: &Path, run: &Value) -> Result<(), OptimiserError> {
        let file = std::fs::File::open(path).map_err(|error| refused(path, error))?;
        // SAFETY: the checkpoint belongs to this program, and is replaced atomically.
        let bytes = unsafe { memmap2::Mmap::map(&file) }.map_err(|error| refused(path, error))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| refused(path, error))?;
        let (_, metadata) =
            SafeTensors::read_metadata(&bytes).map_err(|error| refused(path, error))?;
        let metadata = metadata
            .metadata()
            .as_ref()
            .and_then(|metadata| metadata.get(METADATA_KEY));
        let metadata = metadata.ok_or_else(|| refused(path, "not a checkpoint of a training"))?;
        let metadata: CheckpointMetadata = serde_json::from_str(metadata)
            .map_err(|error| refused(path, format!("metadata entry `{METADATA_KEY}`: {error}")))?;
        let differences = differences(&metadata.run, run, ["in the checkpoint", "now"]);
        if !differences.is_empty() {
            return Err(OptimiserError::OtherTraining {
                path: path.display().to_string(),
                differences,
            });
        }
        for parameter in &mut self.parameters {
            let (shape, name) = (parameter.shape.clone(), parameter.name.clone());
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
        (self.step, self.skipped) = (metadata.step, metadata.skipped);
        Ok(())
    }
}

/// Differences between two descriptions, one line per value; `owners` names theirs.
pub fn differences(first: &Value, second: &Value, owners: [&str; 2]) -> Vec<String> {
    let mut lines = Vec::new();
    differ("", [Some(first), Some(second)], owners, &mut lines);
    lines
}

fn differ(path: &str, both: [Option<&Value>; 2], owners: [&str; 2], lines: &mut Vec<String>) {
    let [first, second] = both;
    if let (Some(Value::Object(first)), Some(Value::Object(second))) = (first, second) {
        let keys: BTreeSet<&String> = first.keys().chain(second.keys()).collect();
        for key in keys {
            let dot = if path.is_empty() { "" } else { "." };
            let below = format!("{path}{dot}{key}");
            differ(&below, [first.get(key), second.get(key)], owners, lines);
        }
    } else if first != second {
        let text = |value: Option<&Value>| value.map_or("nothing".to_owned(), Value::to_string);
        let [first_owner, second_owner] = owners;
        let (first, second) = (text(first), text(second));
        lines.push(format!(
            "{path}: {first} {first_owner}, {second} {second_owner}"
        ));
    }
}

fn f32_values(tensor: &TensorView<'_>, shape: &[usize]) -> Option<Vec<f32>> {
    (tensor.dtype() == Dtype::F32 && tensor.shape() == shape).then(|| {
        tensor
            .data()
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    })
}

fn refused(path: &Path, what: impl ToString) -> OptimiserError {
    OptimiserError::Checkpoint {
        path: path.display().to_string(),
        what: what.to_string(),
    }
}
