//! What the inputs of a model's matrices are like: measured once, on the pictures and actions of a bag, for
//! [`NumberFormat::Int8`](wm_model::NumberFormat::Int8).
//!
//! A model folder that [records](crate::folder::DescribedFolder::recorded) computes in f32 and notes, for every matrix and
//! every input of it, the largest absolute value. They are kept in the file [`FILE`] beside its `model.json`, where loading
//! the model in int8 finds them. With them the matrices are [smoothed](wm_model::ops::Smoothing).
//!
//! A calibration is of certain weights, which it names by a hash of their table of tensors with samples of their values.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use wm_model::Weights;
use wm_model::ops::{InputRange, PackedLinear, Smoothing};
use wm_model::weights::{Precision as Stored, WeightsBuilder};

use crate::{Error, Result};

/// Name of a calibration in a model folder.
pub const FILE: &str = "calibration.safetensors";

/// Metadata key of the [`About`] (JSON).
const ABOUT: &str = "calibration";

/// Between the part of a model and the name of a tensor in it.
const BETWEEN: char = '/';

/// How much of the difficulty of inputs moves to the weights by default: what is recommended for most models (Xiao et al.
/// 2023, section 4).
pub const STRENGTH: f32 = 0.5;

/// How a calibration was made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Names of the bags.
    pub bags: Vec<String>,
    /// Frames that the model was run on.
    pub frames: usize,
    /// [`Smoothing::strength`].
    pub strength: f32,
}

/// The metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct About {
    origin: Origin,
    /// Which weights, for every part of the model.
    weights: BTreeMap<String, String>,
}

/// The largest inputs of the matrices of one network.
#[derive(Clone, Debug, PartialEq)]
pub struct InputRanges {
    strength: f32,
    /// By the names of the weights.
    largest: BTreeMap<String, Vec<f32>>,
}

impl InputRanges {
    /// What is known of the inputs that `weight` meets.
    pub(crate) fn smoothing(&self, weight: &str) -> Option<Smoothing<'_>> {
        let largest = self.largest.get(weight)?;
        Some(Smoothing {
            largest,
            strength: self.strength,
        })
    }

    /// SHA-256 (hexadecimal) of names, values and strength.
    pub(crate) fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(format!("{}\n", self.strength));
        for (name, largest) in &self.largest {
            hash.update(format!("{name} {}\n", largest.len()));
            for value in largest {
                hash.update(value.to_le_bytes());
            }
        }
        format!("{:x}", hash.finalize())
    }
}

/// Notes the inputs of the matrices of a model's parts while it computes.
#[derive(Debug, Default)]
pub struct RangeRecorder(Mutex<BTreeMap<(&'static str, String), InputRange>>);

impl RangeRecorder {
    /// The matrix `packed` of the tensor `weight` of `part`, which notes its inputs here.
    pub(crate) fn record(
        &self,
        (part, weight): (&'static str, &str),
        packed: PackedLinear,
    ) -> Result<PackedLinear> {
        let mut ranges = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // A matrix that is loaded twice has one range.
        let range = ranges
            .entry((part, weight.to_owned()))
            .or_insert_with(|| InputRange::new(packed.inputs()));
        Ok(packed.noting(range.clone())?)
    }

    /// The calibration, of parts with these weights. Matrices that did not compute are left out.
    ///
    /// # Errors
    /// If no matrix computed, or an input was not finite.
    pub(crate) fn calibration(
        &self,
        origin: Origin,
        weights: BTreeMap<String, String>,
    ) -> Result<Calibration> {
        let invalid = |reason: String| wm_model::Error::config("calibration", reason);
        let ranges = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut parts = BTreeMap::new();
        for ((part, weight), range) in ranges.iter() {
            let largest = range.largest();
            if let Some(bad) = largest.iter().find(|value| !value.is_finite()) {
                let reason = format!("{part}: an input of {weight} was {bad}");
                return Err(invalid(reason).into());
            }
            if largest.iter().all(|value| *value == 0.0) {
                continue;
            }
            let part = parts.entry((*part).to_owned()).or_insert(InputRanges {
                strength: origin.strength,
                largest: BTreeMap::new(),
            });
            part.largest.insert(weight.clone(), largest);
        }
        if parts.is_empty() {
            return Err(invalid("no matrix of the model computed".to_owned()).into());
        }
        let weights = weights
            .into_iter()
            .filter(|(part, _)| parts.contains_key(part))
            .collect();
        Ok(Calibration {
            about: About { origin, weights },
            parts,
        })
    }
}

/// The largest inputs of all matrices of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    about: About,
    parts: BTreeMap<String, InputRanges>,
}

impl Calibration {
    /// Reads the calibration of the model in `folder`; `None` if it has none.
    ///
    /// # Errors
    /// If the file cannot be read, or is not a calibration.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(FILE);
        if !path.exists() {
            return Ok(None);
        }
        let weights = Weights::open(&path)?;
        let about: About = weights.json(ABOUT)?;
        let malformed = |reason: String| Error::ConfigFile {
            file: path.display().to_string(),
            reason,
        };
        let mut parts = BTreeMap::new();
        for name in weights.names() {
            let (Some((part, weight)), Some(&[inputs])) =
                (name.split_once(BETWEEN), weights.shape(&name))
            else {
                return Err(malformed(format!("`{name}` is no input range")));
            };
            if !about.weights.contains_key(part) {
                return Err(malformed(format!(
                    "`{name}`: it does not say of which weights"
                )));
            }
            let part = parts.entry(part.to_owned()).or_insert(InputRanges {
                strength: about.origin.strength,
                largest: BTreeMap::new(),
            });
            let largest = weights.values(&name, &[inputs])?;
            part.largest.insert(weight.to_owned(), largest);
        }
        Ok(Some(Self { about, parts }))
    }

    /// Writes it into `folder`, in place of one that is there.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut file = WeightsBuilder::new();
        for (part, ranges) in &self.parts {
            for (weight, largest) in &ranges.largest {
                let name = format!("{part}{BETWEEN}{weight}");
                file.values(&name, &[largest.len()], largest, Stored::F32);
            }
        }
        let about = serde_json::to_string(&self.about).map_err(|error| Error::ConfigFile {
            file: folder.join(FILE).display().to_string(),
            reason: error.to_string(),
        })?;
        file.metadata(ABOUT, about);
        Ok(file.write(folder.join(FILE))?)
    }

    /// How it was made.
    pub fn origin(&self) -> &Origin {
        &self.about.origin
    }

    /// How many matrices there are of every part.
    pub fn matrices(&self) -> impl Iterator<Item = (&str, usize)> {
        let parts = self.parts.iter();
        parts.map(|(part, ranges)| (part.as_str(), ranges.largest.len()))
    }

    /// The matrices of `part`, if it knows any.
    pub(crate) fn part(&self, part: &str) -> Option<&InputRanges> {
        self.parts.get(part)
    }

    /// Checks that it is of these weights, if it knows `part`.
    ///
    /// # Errors
    /// [`Error::Calibration`] if it is of others.
    pub(crate) fn check(&self, folder: &Path, part: &'static str, weights: &str) -> Result<()> {
        match self.about.weights.get(part) {
            Some(calibrated) if calibrated != weights => Err(Error::Calibration {
                file: folder.join(FILE),
                part,
                calibrated: calibrated.clone(),
                found: weights.to_owned(),
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_model::NumberFormat;

    fn linear(inputs: usize) -> PackedLinear {
        PackedLinear::new(&vec![1.0; inputs], None, (1, inputs), NumberFormat::F32).unwrap()
    }

    fn origin() -> Origin {
        Origin {
            bags: vec!["a.mcap".to_owned()],
            frames: 3,
            strength: 0.5,
        }
    }

    fn weights() -> BTreeMap<String, String> {
        [("encoder", "1"), ("decoder", "2")]
            .map(|(part, hash)| (part.to_owned(), hash.to_owned()))
            .into()
    }

    #[test]
    fn what_was_recorded_is_written_and_read() {
        let recorder = RangeRecorder::default();
        let record = |part, weight, inputs| {
            let matrix = recorder.record((part, weight), linear(inputs));
            matrix.unwrap()
        };
        record("encoder", "a.weight", 2).forward(&[1.0, -3.0], &mut [0.0]);
        // The same matrix, loaded again.
        record("encoder", "a.weight", 2).forward(&[2.0, 0.0], &mut [0.0]);
        record("encoder", "unused.weight", 3);
        record("decoder", "a.weight", 1).forward(&[5.0], &mut [0.0]);
        let calibration = recorder.calibration(origin(), weights()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Calibration::read(folder.path()).unwrap(), None);
        calibration.write(folder.path()).unwrap();
        let read = Calibration::read(folder.path()).unwrap().unwrap();
        assert_eq!(read, calibration);
        assert_eq!(read.origin(), &origin());
        let matrices: Vec<_> = read.matrices().collect();
        assert_eq!(matrices, [("decoder", 1), ("encoder", 1)]);
        let encoder = read.part("encoder").unwrap();
        assert_eq!(encoder.smoothing("a.weight").unwrap().largest, [2.0, 3.0]);
        assert!(encoder.smoothing("unused.weight").is_none());
        assert_ne!(encoder.sha256(), read.part("decoder").unwrap().sha256());
        assert!(read.part("probe").is_none());

        read.check(folder.path(), "encoder", "1").unwrap();
        read.check(folder.path(), "probe", "1").unwrap();
        let error = read.check(folder.path(), "encoder", "7").unwrap_err();
        let message = error.to_string();
        for part in ["encoder", "1", "7", FILE, "wm model calibrate"] {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn what_is_not_finite_or_nothing_is_no_calibration() {
        let recorder = RangeRecorder::default();
        let refused = || {
            let error = recorder.calibration(origin(), weights()).unwrap_err();
            error.to_string()
        };
        assert!(refused().contains("no matrix"), "{}", refused());
        let matrix = recorder.record(("encoder", "a.weight"), linear(1)).unwrap();
        matrix.forward(&[f32::INFINITY], &mut [0.0]);
        assert!(refused().contains("encoder: an input of a.weight was inf"));
    }

    #[test]
    fn another_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = WeightsBuilder::new();
        file.values("encoder", &[1], &[1.0], Stored::F32);
        file.write(folder.path().join(FILE)).unwrap();
        let error = Calibration::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("calibration"), "{error}");
        let about = About {
            origin: origin(),
            weights: weights(),
        };
        file.metadata(ABOUT, serde_json::to_string(&about).unwrap());
        file.write(folder.path().join(FILE)).unwrap();
        let error = Calibration::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("`encoder` is no input range"), "{error}");
    }
}
