//! Reading safetensors weights, with errors that name what is wrong.

mod builder;

pub use builder::{Precision, WeightsBuilder};

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::path::Path;

use candle_core::{Device, Tensor};
use half::{bf16, f16};
use memmap2::Mmap;
use safetensors::SafeTensors;
use safetensors::tensor::{Dtype, Metadata};
use sha2::{Digest, Sha256};

use crate::{Error, Result};

/// Metadata entry with the hash of all tensors, written by [`WeightsBuilder`].
pub(crate) const CONTENT_HASH: &str = "sha256";

enum Bytes {
    Mapped(Mmap),
    Static(&'static [u8]),
    Owned(Vec<u8>),
}

impl Bytes {
    fn as_slice(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Static(bytes) => bytes,
            Self::Owned(bytes) => bytes,
        }
    }
}

/// An open safetensors file.
///
/// Each tensor is asked for by name and shape; [`Weights::finish`] then tells of tensors that
/// nobody asked for.
pub struct Weights {
    file: String,
    bytes: Bytes,
    /// Where the tensor data begin.
    data_start: usize,
    header: Metadata,
    used: RefCell<BTreeSet<String>>,
}

impl std::fmt::Debug for Weights {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Weights").field("file", &self.file).finish()
    }
}

impl Weights {
    /// Maps the file at `path` into memory.
    ///
    /// # Errors
    /// If the file cannot be read, is no safetensors file, or does not match the content hash that
    /// it states.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        // SAFETY: the map is only read, and weights are replaced by renaming a new file over the
        // old one, never rewritten in place, so the mapped bytes do not change under us.
        let map = unsafe { Mmap::map(&file) }.map_err(|e| Error::io(path, e))?;
        Self::new(path.display().to_string(), Bytes::Mapped(map))
    }

    /// Reads weights that are part of the program; `name` is what errors call them.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn from_static(name: &str, bytes: &'static [u8]) -> Result<Self> {
        Self::new(name.to_owned(), Bytes::Static(bytes))
    }

    /// Reads weights from memory; `name` is what errors call them.
    ///
    /// # Errors
    /// As [`Weights::open`].
    pub fn from_bytes(name: &str, bytes: Vec<u8>) -> Result<Self> {
        Self::new(name.to_owned(), Bytes::Owned(bytes))
    }

    fn new(file: String, bytes: Bytes) -> Result<Self> {
        let corrupt = |reason: String| Error::CorruptWeights {
            file: file.clone(),
            reason,
        };
        // `deserialize` also checks that the tensors cover the data exactly.
        SafeTensors::deserialize(bytes.as_slice()).map_err(|e| corrupt(e.to_string()))?;
        let (header_len, header) =
            SafeTensors::read_metadata(bytes.as_slice()).map_err(|e| corrupt(e.to_string()))?;
        let weights = Self {
            file,
            data_start: header_len + 8,
            bytes,
            header,
            used: RefCell::default(),
        };
        if let Some(expected) = weights.metadata(CONTENT_HASH) {
            let found = weights.sha256();
            if *expected != found {
                return Err(Error::WrongHash {
                    file: weights.file.clone(),
                    what: "the SHA-256 of the tensors",
                    expected: expected.to_owned(),
                    found,
                });
            }
        }
        Ok(weights)
    }

    /// Where the bytes came from, as errors name it.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// SHA-256 (hexadecimal) over names, types, shapes and data of all tensors, in name order.
    /// The metadata is not part of it.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        let tensors: BTreeMap<_, _> = self.header.tensors().into_iter().collect();
        for (name, info) in tensors {
            hash_tensor_header(&mut hash, &name, &info.dtype.to_string(), &info.shape);
            hash.update(self.data(info.data_offsets));
        }
        hex(hash)
    }

    /// SHA-256 (hexadecimal) over [`Weights::sha256`] and the metadata entries `keys`: two files of the same tensors that
    /// say something else about them differ.
    ///
    /// # Errors
    /// [`Error::Metadata`] if an entry is missing.
    pub fn identity(&self, keys: &[&str]) -> Result<String> {
        let mut hash = Sha256::new();
        hash.update(self.sha256());
        for key in keys {
            let entry = self.require_metadata(key)?;
            hash.update(format!("\n{key} {}\n{entry}", entry.len()));
        }
        Ok(hex(hash))
    }

    /// A metadata entry.
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.header
            .metadata()
            .as_ref()?
            .get(key)
            .map(String::as_str)
    }

    /// A metadata entry that must be there.
    ///
    /// # Errors
    /// [`Error::Metadata`] if it is not.
    pub(crate) fn require_metadata(&self, key: &str) -> Result<&str> {
        self.metadata(key).ok_or_else(|| Error::Metadata {
            file: self.file.clone(),
            key: key.to_owned(),
            reason: "missing".to_owned(),
        })
    }

    /// A metadata entry that must be there and hold a `T` as JSON.
    ///
    /// # Errors
    /// [`Error::Metadata`] if it is missing or malformed.
    pub fn json<T: serde::de::DeserializeOwned>(&self, key: &str) -> Result<T> {
        serde_json::from_str(self.require_metadata(key)?).map_err(|e| Error::Metadata {
            file: self.file.clone(),
            key: key.to_owned(),
            reason: e.to_string(),
        })
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> Vec<String> {
        let mut names = self.header.offset_keys();
        names.sort();
        names
    }

    /// Whether there is a tensor called `name`.
    pub fn contains(&self, name: &str) -> bool {
        self.header.info(name).is_some()
    }

    /// Shape of the tensor `name`, if there is one.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.header.info(name).map(|info| info.shape.as_slice())
    }

    /// The values of tensor `name`, widened to f32, in row-major order.
    ///
    /// # Errors
    /// If the tensor is missing, has another shape, is not of a float type or holds a value that is
    /// not finite.
    pub fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let file = || self.file.clone();
        let info = self.header.info(name).ok_or_else(|| Error::MissingTensor {
            file: file(),
            name: name.to_owned(),
            expected: shape.to_vec(),
        })?;
        self.used.borrow_mut().insert(name.to_owned());
        if info.shape != shape {
            return Err(Error::TensorShape {
                file: file(),
                name: name.to_owned(),
                expected: shape.to_vec(),
                found: info.shape.clone(),
            });
        }
        let data = self.data(info.data_offsets);
        let values: Vec<f32> = match info.dtype {
            Dtype::F32 => data
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect(),
            Dtype::F16 => data
                .as_chunks::<2>()
                .0
                .iter()
                .map(|b| f16::from_le_bytes(*b).to_f32())
                .collect(),
            Dtype::BF16 => data
                .as_chunks::<2>()
                .0
                .iter()
                .map(|b| bf16::from_le_bytes(*b).to_f32())
                .collect(),
            other => {
                return Err(Error::TensorType {
                    file: file(),
                    name: name.to_owned(),
                    found: other.to_string(),
                });
            }
        };
        if values.iter().any(|v| !v.is_finite()) {
            return Err(Error::TensorNotFinite {
                file: file(),
                name: name.to_owned(),
            });
        }
        Ok(values)
    }

    /// Tensor `name`, widened to f32, on the CPU.
    ///
    /// # Errors
    /// As [`Weights::values`].
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Result<Tensor> {
        Ok(Tensor::from_vec(
            self.values(name, shape)?,
            shape,
            &Device::Cpu,
        )?)
    }

    /// Checks that every tensor was asked for.
    ///
    /// # Errors
    /// [`Error::UnexpectedTensors`] with the names of the rest.
    pub fn finish(self) -> Result<()> {
        let used = self.used.borrow();
        let names: Vec<_> = self
            .names()
            .into_iter()
            .filter(|name| !used.contains(name))
            .collect();
        if names.is_empty() {
            return Ok(());
        }
        Err(Error::UnexpectedTensors {
            file: self.file.clone(),
            names,
        })
    }

    fn data(&self, (start, end): (usize, usize)) -> &[u8] {
        // The offsets were checked against the length when the file was opened.
        self.bytes
            .as_slice()
            .get(self.data_start + start..self.data_start + end)
            .unwrap_or_default()
    }
}

pub(crate) fn hash_tensor_header(hash: &mut Sha256, name: &str, dtype: &str, shape: &[usize]) {
    hash.update(format!("{name}:{dtype}:{shape:?}\n").as_bytes());
}

/// The hexadecimal form of a finished hash.
pub(crate) fn hex(hash: Sha256) -> String {
    hash.finalize()
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests;
