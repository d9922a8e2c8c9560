use std::{
    collections::{BTreeSet, HashMap},
    path::Path,
};

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{AdamW, OptimiserError, State};

/// The metadata entry of a checkpoint.
const TOLD: &str = "training";

/// What a checkpoint tells besides its tensors.
#[derive(Serialize, Deserialize)]
struct Told {
    step: u64,
    skipped: u64,
    run: Value,
}

/// The buffers of one parameter, under the prefixes that they are stored with.
fn buffers(parameter: &mut State) -> [(&'static str, &mut Vec<f32>); 4] {
    [
        ("weights", &mut parameter.weights),
        ("ema", &mut parameter.ema),
        ("first_moment", &mut parameter.first_moment),
        ("second_moment", &mut parameter.second_moment),
    ]
}

impl AdamW {
    /// Writes the whole state to a safetensors file. `run` tells what is being trained (settings, data), so that another
    /// training does not resume from it. The file is replaced in one move: a kill leaves the old or the new one.
    ///
    /// # Errors
    /// When the file cannot be written.
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
        // One entry: the order of several would differ from file to file.
        let told = Told {
            step: self.step,
            skipped: self.skipped,
            run: run.clone(),
        };
        let told = serde_json::to_string(&told).map_err(|error| refused(path, error))?;
        let metadata = HashMap::from([(TOLD.to_owned(), told)]);
        let partial = path.with_extension("partial");
        safetensors::serialize_to_file(tensors, Some(metadata), &partial)
            .map_err(|error| refused(path, error))?;
        std::fs::rename(&partial, path).map_err(|error| refused(path, error))
    }

    /// Takes up the state that [`Self::save`] wrote for the same `run`.
    ///
    /// # Errors
    /// When the file cannot be read, is of another training (what differs is named), or lacks a parameter or has it in
    /// another shape.
    pub fn resume(&mut self, path: &Path, run: &Value) -> Result<(), OptimiserError> {
        let file = std::fs::File::open(path).map_err(|error| refused(path, error))?;
        // SAFETY: the checkpoint is this program's own, and replaced in one move.
        let bytes = unsafe { memmap2::Mmap::map(&file) }.map_err(|error| refused(path, error))?;
        let file = SafeTensors::deserialize(&bytes).map_err(|error| refused(path, error))?;
        let (_, metadata) =
            SafeTensors::read_metadata(&bytes).map_err(|error| refused(path, error))?;
        let told = metadata.metadata().as_ref().and_then(|told| told.get(TOLD));
        let told = told.ok_or_else(|| refused(path, "no checkpoint of a training"))?;
        let told: Told = serde_json::from_str(told)
            .map_err(|error| refused(path, format!("metadata entry `{TOLD}`: {error}")))?;
        let mut differences = Vec::new();
        differ("", Some(&told.run), Some(run), &mut differences);
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
        (self.step, self.skipped) = (told.step, told.skipped);
        Ok(())
    }
}

/// What differs between two descriptions, a line for each value.
fn differ(path: &str, saved: Option<&Value>, now: Option<&Value>, lines: &mut Vec<String>) {
    if let (Some(Value::Object(saved)), Some(Value::Object(now))) = (saved, now) {
        let keys: BTreeSet<&String> = saved.keys().chain(now.keys()).collect();
        for key in keys {
            let dot = if path.is_empty() { "" } else { "." };
            let below = format!("{path}{dot}{key}");
            differ(&below, saved.get(key), now.get(key), lines);
        }
    } else if saved != now {
        let told = |value: Option<&Value>| value.map_or("nothing".to_owned(), Value::to_string);
        let (saved, now) = (told(saved), told(now));
        lines.push(format!("{path}: {saved} in the checkpoint, {now} now"));
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
