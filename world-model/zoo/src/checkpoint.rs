//! Files of tensors: safetensors, and what `torch.save` writes.
//!
//! A file is mapped into memory and a tensor's values are copied out when it is asked for; the pages that were read
//! are given back at once, so that loading takes the memory of the loaded weights and little more. A torch file is a
//! zip archive of uncompressed values beside a pickle that says where each tensor lies; the pickle is read as data and
//! nothing in it is ever executed.
//!
//! Names are those of the authors, without what wrappers put before them (`_orig_mod.`, `module.`, `backbone.`). A file
//! that holds several state dicts has [parts](Checkpoint::part), named by the first component of the names:
//!
//! ```
//! use safetensors::{Dtype, serialize, tensor::TensorView};
//! use wm_zoo::{Checkpoint, checkpoint::Average};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let values = [1f32, 2.0].map(f32::to_le_bytes).concat();
//! let tensor = || TensorView::new(Dtype::F32, vec![2], &values);
//! let tensors = [("ema.module.head.weight", tensor()?), ("model.module.head.weight", tensor()?)];
//! let checkpoint = Checkpoint::from_bytes("example", serialize(tensors, None)?)?;
//! let weights = checkpoint.weights(Average::Ema);
//! assert_eq!(weights.names().collect::<Vec<_>>(), ["head.weight"]);
//! # Ok(())
//! # }
//! ```

mod bytes;
mod convert;
mod element;
mod entry;
mod index;
mod names;
mod pickle;
mod safetensors_index;
mod state_dict;
mod storage;
mod torch_index;
mod values;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use candle_core::{DType, Device, Tensor};
use sha2::{Digest as _, Sha256};

pub use convert::{Conversion, convert};
pub use element::Element;

use bytes::Bytes;
use entry::Entry;

use crate::packed_cache::Stamp;
use crate::{Error, Result};

/// Which of a training's weights to take where a checkpoint has both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Average {
    /// The exponential moving average, which evaluation uses.
    #[default]
    Ema,
    /// The weights as the optimiser left them.
    Raw,
}

/// Names of the parts that may be wrapped around a network's tensors, in the order in which they are looked for.
const WRAPPERS_EMA: [&str; 5] = ["ema", "model_ema", "ema_model", "state_dict", "model"];
const WRAPPERS_RAW: [&str; 2] = ["state_dict", "model"];

/// Places in a file that a fingerprint samples, and bytes of each.
const SAMPLES: (usize, usize) = (64, 4096);

/// Wrappers within wrappers, as deep as this, are taken off.
const MAX_WRAPPERS: usize = 4;

/// An open file of tensors, or a part of it. Clones share the file.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    file: String,
    /// Which part of the file it is, with dots between the names; empty for the whole.
    part: String,
    bytes: Arc<Bytes>,
    entries: BTreeMap<String, Entry>,
}

impl Checkpoint {
    /// Maps the file at `path` into memory; which format it is, its first bytes tell.
    ///
    /// # Errors
    /// If the file cannot be read, or is of no format that is known.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        Self::new(path.display().to_string(), Bytes::open(path)?)
    }

    /// Reads a file that is in memory; `name` is what errors call it.
    ///
    /// # Errors
    /// If the file is of no format that is known.
    pub fn from_bytes(name: &str, bytes: Vec<u8>) -> Result<Self> {
        Self::new(name.to_owned(), Bytes::Owned(bytes))
    }

    fn new(file: String, bytes: Bytes) -> Result<Self> {
        let entries = index::index(bytes.as_slice()).map_err(|reason| Error::Corrupt {
            file: file.clone(),
            reason,
        })?;
        Ok(Self {
            file,
            part: String::new(),
            bytes: Arc::new(bytes),
            entries: names::clean(entries),
        })
    }

    /// Where the bytes came from, as errors name it.
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Which part of the file it is, with dots between the names; empty for the whole.
    pub fn part_name(&self) -> &str {
        &self.part
    }

    /// Names of all tensors, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// Names of the tensors of floating-point numbers, sorted.
    pub(crate) fn float_names(&self) -> impl Iterator<Item = &str> {
        self.entries
            .iter()
            .filter(|(_, entry)| entry.element.is_float())
            .map(|(name, _)| name.as_str())
    }

    /// Whether there is a tensor `name`.
    pub fn contains(&self, name: &str) -> bool {
        self.entries.contains_key(name)
    }

    /// Shape of the tensor `name`, if there is one.
    pub fn shape(&self, name: &str) -> Option<&[usize]> {
        self.entries.get(name).map(|entry| entry.shape.as_slice())
    }

    /// Number format of the tensor `name`, if there is one.
    #[cfg(test)]
    fn element(&self, name: &str) -> Option<Element> {
        self.entries.get(name).map(|entry| entry.element)
    }

    /// Number of values in all tensors of floating-point numbers.
    pub fn parameters(&self) -> usize {
        let floats = self.entries.values().filter(|e| e.element.is_float());
        floats.map(Entry::count).sum()
    }

    /// The values of the tensor `name`, which must be floating-point numbers, as `dtype`, on the CPU.
    ///
    /// # Errors
    /// If there is no such tensor, it holds other numbers or one that is not finite, its bytes in a torch file are not
    /// those of the archive's CRC-32, or `dtype` is none of f32, f16 and bf16.
    pub fn tensor(&self, name: &str, dtype: DType) -> Result<Tensor> {
        let entry = self.floats(name)?;
        let storage = values::read(&self.bytes, entry, dtype)?;
        if !values::are_finite(&storage) {
            return Err(self.not_finite(name));
        }
        values::into_tensor(storage, &entry.shape, &Device::Cpu)
    }

    /// What `read` makes of the values of the tensor `name`, which must be floating-point numbers, in row-major order:
    /// without a copy if they are f32 in the file. Beyond what [`Checkpoint::tensor`] refuses, those that bf16 cannot hold
    /// are refused if they are to be rounded to it.
    pub(crate) fn with_values<R>(
        &self,
        name: &str,
        is_rounded: bool,
        read: impl FnOnce(&[f32]) -> R,
    ) -> Result<R> {
        let entry = self.floats(name)?;
        let made = values::with_f32(&self.bytes, entry, |values| {
            values::stay_finite(values, is_rounded).then(|| read(values))
        });
        made.ok_or_else(|| self.not_finite(name))
    }

    /// The tensors whose names start with `name` and a dot, by what follows; `None` if there are none.
    pub fn part(&self, name: &str) -> Option<Self> {
        let start = format!("{name}.");
        let entries: BTreeMap<String, Entry> = self
            .entries
            .range(start.clone()..)
            .take_while(|(name, _)| name.starts_with(&start))
            .filter_map(|(name, e)| Some((name.strip_prefix(&start)?.to_owned(), e.clone())))
            .collect();
        (!entries.is_empty()).then(|| Self {
            file: self.file.clone(),
            part: match self.part.as_str() {
                "" => name.to_owned(),
                part => format!("{part}.{name}"),
            },
            bytes: Arc::clone(&self.bytes),
            entries: names::clean(entries),
        })
    }

    /// As [`Checkpoint::part`], of a part that has to be there.
    ///
    /// # Errors
    /// [`Error::NoSuchPart`] if it is not.
    pub fn require_part(&self, name: &str) -> Result<Self> {
        self.part(name).ok_or_else(|| Error::NoSuchPart {
            file: self.file.clone(),
            part: name.to_owned(),
            found: self.parts(),
        })
    }

    /// The first of `names` that is a part; the whole if none is.
    pub(crate) fn first_part(&self, names: &[&str]) -> Self {
        names
            .iter()
            .find_map(|name| self.part(name))
            .unwrap_or_else(|| self.clone())
    }

    /// First components of all names, each once.
    pub fn parts(&self) -> Vec<String> {
        let first = |name: &str| name.split('.').next().unwrap_or(name).to_owned();
        let parts: BTreeSet<String> = self.names().map(first).collect();
        parts.into_iter().collect()
    }

    /// The network's tensors, without what a training wraps around them: `state_dict`, `model`, or under
    /// [`Average::Ema`] the average if there is one (`ema`, `model_ema`, `ema_model`).
    pub fn weights(&self, average: Average) -> Self {
        let wrappers: &[&str] = match average {
            Average::Ema => &WRAPPERS_EMA,
            Average::Raw => &WRAPPERS_RAW,
        };
        let mut weights = self.clone();
        for _ in 0..MAX_WRAPPERS {
            match wrappers.iter().find_map(|name| weights.part(name)) {
                Some(part) => weights = part,
                None => break,
            }
        }
        weights
    }

    /// Which state of which file it is, if it was opened as one.
    pub(crate) fn stamp(&self) -> Option<&Stamp> {
        self.bytes.stamp()
    }

    /// SHA-256 (hexadecimal) over the table of the tensors, with the checksums that the file states, and samples of the
    /// whole file: without reading all of it.
    pub(crate) fn fingerprint(&self) -> String {
        let mut hash = Sha256::new();
        for (name, entry) in &self.entries {
            let Entry {
                element,
                shape,
                strides,
                start,
                storage,
            } = entry;
            let checksum = storage.as_ref().and_then(|storage| storage.crc32());
            let element = element.name();
            hash.update(format!(
                "{name} {element} {shape:?} {strides:?} {start} {checksum:?}\n"
            ));
        }
        let bytes = self.bytes.as_slice();
        let (count, length) = SAMPLES;
        for sample in bytes.chunks(bytes.len().div_ceil(count).max(length)) {
            // The last sample may be shorter.
            hash.update(sample.get(..length).unwrap_or(sample));
        }
        format!("{:x}", hash.finalize())
    }

    /// Checks the values of `entry` against the checksum that the file states of them, if it states one.
    fn verify(&self, entry: &Entry) -> Result<()> {
        let Some(storage) = &entry.storage else {
            return Ok(());
        };
        storage
            .verify(&self.bytes)
            .map_err(|reason| Error::Corrupt {
                file: self.file.clone(),
                reason,
            })
    }

    /// The entry of floating-point numbers `name`, of which the file's checksum is right if it states one.
    fn floats(&self, name: &str) -> Result<&Entry> {
        let entry = self.entry(name)?;
        if !entry.element.is_float() {
            return Err(wm_model::Error::TensorType {
                file: self.file.clone(),
                name: name.to_owned(),
                found: entry.element.name().to_owned(),
            }
            .into());
        }
        self.verify(entry)?;
        Ok(entry)
    }

    fn not_finite(&self, name: &str) -> Error {
        Error::Model(wm_model::Error::TensorNotFinite {
            file: self.file.clone(),
            name: name.to_owned(),
        })
    }

    fn entry(&self, name: &str) -> Result<&Entry> {
        self.entries.get(name).ok_or_else(|| {
            wm_model::Error::MissingTensor {
                file: self.file.clone(),
                name: name.to_owned(),
                expected: Vec::new(),
            }
            .into()
        })
    }
}

#[cfg(test)]
mod tests;
