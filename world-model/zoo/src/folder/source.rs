//! A part of a model: its kind, its configuration and its checkpoint.

use std::path::Path;

use sha2::{Digest as _, Sha256};
use wm_model::Compute;

use super::Part;
use crate::calibration::{Calibration, RangeRecorder};
use crate::checkpoint::Average;
use crate::kinds::Kind;
use crate::loader::Requested;
use crate::{Checkpoint, Loader, Result};

/// What is known of the inputs of a model's matrices.
#[derive(Debug)]
pub(super) enum KnownInputs {
    Nothing,
    /// For matrices of 8 bits.
    Calibrated(Calibration),
    /// What is to be known is being noted.
    Recorded(RangeRecorder),
}

/// A part's files, open; its values are still to be read.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// What the part is for the model: `encoder`, `adapter`, ...
    pub(super) role: &'static str,
    pub(super) kind: Kind,
    /// JSON.
    pub(super) config: String,
    /// The network's tensors.
    checkpoint: Checkpoint,
}

impl Source {
    pub(super) fn open(role: &'static str, part: &Part, folder: &Path) -> Result<Self> {
        let kind: Kind = part.kind.parse()?;
        let checkpoint = Checkpoint::open(folder.join(&part.weights))?;
        Ok(Self {
            role,
            kind,
            config: part.config.text(folder)?,
            checkpoint: kind.weights(&checkpoint, Average::Ema),
        })
    }

    /// Has a model built without its values: what it asks for, if the checkpoint has just that.
    pub(super) fn survey<M>(
        &self,
        load: impl FnOnce(&Loader<'_>) -> Result<M>,
    ) -> Result<Vec<Requested>> {
        let loader = Loader::survey(&self.checkpoint);
        load(&loader)?;
        loader.finish()?;
        Ok(loader.requested())
    }

    /// Builds a model from its values, for the device, number format and kernels of `compute`.
    pub(super) fn load<M>(
        &self,
        compute: &Compute,
        known: &KnownInputs,
        load: impl FnOnce(&Loader<'_>) -> Result<M>,
    ) -> Result<M> {
        let mut loader = Loader::new(&self.checkpoint, compute)?;
        match known {
            KnownInputs::Nothing => {}
            KnownInputs::Calibrated(calibration) => {
                if let Some(ranges) = calibration.part(self.role) {
                    loader = loader.with_ranges(ranges);
                }
            }
            KnownInputs::Recorded(recorder) => loader = loader.recorded(recorder, self.role),
        }
        let model = load(&loader)?;
        loader.finish()?;
        Ok(model)
    }

    /// Which weights these are, as a calibration names them.
    pub(super) fn fingerprint(&self) -> String {
        self.checkpoint.fingerprint()
    }

    /// Adds name, shape and values of the tensors that a model asked for, in order: the same for every file and number
    /// format that holds the same values.
    pub(super) fn hash(&self, tensors: &[Requested], hash: &mut Sha256) -> Result<()> {
        hash.update(format!("{} {}\n", self.role, self.kind));
        for Requested { name, shape } in tensors {
            hash.update(format!("{name} {shape:?}\n"));
            self.checkpoint.with_values(name, false, |values| {
                if cfg!(target_endian = "little") {
                    hash.update(bytemuck::cast_slice::<f32, u8>(values));
                } else {
                    for value in values {
                        hash.update(value.to_le_bytes());
                    }
                }
            })?;
        }
        Ok(())
    }
}
