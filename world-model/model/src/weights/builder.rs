//! Writing safetensors weights.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::Path;

use candle_core::{DType, Tensor};
use half::f16;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::{CONTENT_HASH, hash_tensor_header, hex};
use crate::{Error, Result};

/// Number format of written weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 32-bit floats.
    F32,
    /// 16-bit floats.
    F16,
}

impl Precision {
    fn name(self) -> &'static str {
        match self {
            Self::F32 => "F32",
            Self::F16 => "F16",
        }
    }

    fn encode(self, values: &[f32]) -> Vec<u8> {
        match self {
            Self::F32 => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
            Self::F16 => values
                .iter()
                .flat_map(|v| f16::from_f32(*v).to_le_bytes())
                .collect(),
        }
    }

    /// What `value` becomes when it is written and read again.
    pub fn round(self, value: f32) -> f32 {
        match self {
            Self::F32 => value,
            Self::F16 => f16::from_f32(value).to_f32(),
        }
    }
}

/// Collects tensors and metadata and writes them as safetensors, the same bytes for the same
/// content.
#[derive(Debug, Default)]
pub struct WeightsBuilder {
    tensors: BTreeMap<String, (Precision, Vec<usize>, Vec<u8>)>,
    metadata: BTreeMap<String, String>,
}

impl WeightsBuilder {
    /// An empty file.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a tensor.
    ///
    /// # Errors
    /// If the tensor cannot be brought to the CPU as f32.
    pub fn tensor(&mut self, name: &str, tensor: &Tensor, precision: Precision) -> Result<()> {
        let values = tensor
            .to_dtype(DType::F32)?
            .flatten_all()?
            .to_vec1::<f32>()?;
        self.values(name, tensor.dims(), &values, precision);
        Ok(())
    }

    /// Adds a tensor given by its shape and its values in row-major order.
    pub fn values(&mut self, name: &str, shape: &[usize], values: &[f32], precision: Precision) {
        self.tensors.insert(
            name.to_owned(),
            (precision, shape.to_vec(), precision.encode(values)),
        );
    }

    /// Adds a metadata entry.
    pub fn metadata(&mut self, key: &str, value: impl Into<String>) {
        self.metadata.insert(key.to_owned(), value.into());
    }

    /// The whole file; a metadata entry `sha256` holds the hash of the tensors.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut hash = Sha256::new();
        let mut header = serde_json::Map::new();
        let mut offset = 0;
        for (name, (precision, shape, data)) in &self.tensors {
            hash_tensor_header(&mut hash, name, precision.name(), shape);
            hash.update(data);
            let end = offset + data.len();
            header.insert(
                name.clone(),
                json!({"dtype": precision.name(), "shape": shape, "data_offsets": [offset, end]}),
            );
            offset = end;
        }
        let mut metadata = self.metadata.clone();
        metadata.insert(CONTENT_HASH.to_owned(), hex(hash));
        header.insert("__metadata__".to_owned(), json!(metadata));
        let mut header = Value::Object(header).to_string().into_bytes();
        // The format pads the header with spaces so that the data are aligned.
        header.resize(header.len().next_multiple_of(8), b' ');

        let mut bytes = Vec::with_capacity(8 + header.len() + offset);
        bytes.extend_from_slice(&(header.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&header);
        for (_, _, data) in self.tensors.values() {
            bytes.extend_from_slice(data);
        }
        bytes
    }

    /// Writes the file; a reader sees either the old file or the whole new one.
    ///
    /// # Errors
    /// If the folder or the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        }
        let partial = path.with_extension("partial");
        let write = || -> std::io::Result<()> {
            let mut file = fs::File::create(&partial)?;
            file.write_all(&self.to_bytes())?;
            file.sync_all()?;
            fs::rename(&partial, path)
        };
        write().map_err(|e| Error::io(path, e))
    }
}
