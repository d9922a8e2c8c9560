//! One loading of a model, with a cache.

use std::path::PathBuf;
use std::thread;

use sha2::{Digest as _, Sha256};
use wm_model::NumberFormat;
use wm_model::ops::{PackedLinear, packed_layout};

use super::PackedCache;
use super::header::Refusal;
use super::identity::{Identity, Stamp};
use super::packed_file::{self, PackedFile};
use crate::Checkpoint;
use crate::calibration::InputRanges;

/// Takes packed matrices from the cache's file as they are asked for, and writes a new one if one was not there.
#[derive(Debug)]
pub(crate) struct Session {
    cache: PackedCache,
    stamp: Stamp,
    identity: Identity,
    /// What names the file, but for the first matrix.
    source: String,
    /// What was there, from the first request on.
    opened: Option<Opened>,
    /// All that was asked for; clones share the values.
    packed: Vec<(String, PackedLinear)>,
    is_complete: bool,
}

#[derive(Debug)]
struct Opened {
    place: PathBuf,
    file: Option<PackedFile>,
}

impl Session {
    /// Of loading `checkpoint` in `format`; `None` for what is not kept.
    pub(crate) fn new(
        cache: PackedCache,
        checkpoint: &Checkpoint,
        format: NumberFormat,
    ) -> Option<Self> {
        let stamp = checkpoint.stamp()?.clone();
        // Packed, 16 bits become 32 at most.
        if stamp.state.length().saturating_mul(2) < cache.limits.least {
            return None;
        }
        let contents = checkpoint.fingerprint();
        let path = stamp.path.to_string_lossy();
        let part = checkpoint.part_name();
        Some(Self {
            cache,
            identity: Identity {
                state: stamp.state,
                contents,
            },
            source: format!("{path}\n{part}\n{format}\n{}\n", packed_layout()),
            stamp,
            opened: None,
            packed: Vec::new(),
            is_complete: true,
        })
    }

    /// Keeps what is packed with `ranges` apart from what is packed otherwise; before anything is asked for.
    pub(crate) fn distinguish(&mut self, ranges: &InputRanges) {
        self.source.push_str(&ranges.sha256());
        self.source.push('\n');
    }

    /// The matrix `name`, if it was kept.
    pub(crate) fn linear(
        &mut self,
        name: &str,
        shape: (usize, usize),
        format: NumberFormat,
        bias: Option<&[f32]>,
    ) -> Option<PackedLinear> {
        let opened = self.opened.get_or_insert_with(|| {
            let hash = Sha256::digest(format!("{}{name}", self.source));
            let name = format!("{hash:x}").chars().take(32).collect::<String>();
            let place = self.cache.place(&name);
            let file = PackedFile::open(&place, &self.identity).unwrap_or_else(|refusal| {
                tracing::info!("{} is packed anew: {refusal}", place.display());
                None
            });
            Opened { place, file }
        });
        let packed = opened.file.as_ref()?.linear(name, shape, format, bias)?;
        self.packed.push((name.to_owned(), packed.clone()));
        Some(packed)
    }

    /// Notes what was not kept.
    pub(crate) fn note(&mut self, name: &str, packed: &PackedLinear) {
        self.packed.push((name.to_owned(), packed.clone()));
        self.is_complete = false;
    }

    /// Ends the loading, of a model that got all its tensors: a thread writes what is to be kept and was not there.
    pub(crate) fn finish(&mut self) {
        let packed = std::mem::take(&mut self.packed);
        let is_complete = std::mem::replace(&mut self.is_complete, true);
        let Some(Opened { place, .. }) = self.opened.take() else {
            return;
        };
        let bytes = packed
            .iter()
            .map(|(_, packed)| packed.packed_length() as u64);
        let bytes = bytes.sum();
        if is_complete || bytes < self.cache.limits.least {
            return;
        }
        let age = self.stamp.age_seconds();
        if age < self.cache.limits.settled.as_secs_f64() {
            tracing::debug!("packed weights are not kept: {age:.1} s ago the checkpoint changed");
            return;
        }
        let writing = Writing {
            cache: self.cache.clone(),
            stamp: self.stamp.clone(),
            identity: self.identity.clone(),
            place,
            packed,
            bytes,
        };
        let writer = thread::Builder::new().name("packed_cache".to_owned());
        match writer.spawn(move || writing.log()) {
            Ok(writer) => self.cache.writers().push(writer),
            Err(error) => tracing::info!("packed weights are not kept: {error}"),
        }
    }
}

/// A file that is to be written.
struct Writing {
    cache: PackedCache,
    stamp: Stamp,
    identity: Identity,
    place: PathBuf,
    packed: Vec<(String, PackedLinear)>,
    /// Of all matrices.
    bytes: u64,
}

impl Writing {
    fn log(self) {
        let (place, bytes) = (self.place.display().to_string(), self.bytes);
        match self.write() {
            Ok(true) => tracing::info!("packed weights are kept in {place}, {} MiB", bytes >> 20),
            Ok(false) => tracing::debug!("packed weights are being written to {place} already"),
            Err(reason) => tracing::info!("packed weights are not kept in {place}: {reason}"),
        }
    }

    /// Whether it was written: not if another is at it.
    fn write(self) -> Result<bool, Refusal> {
        let Some(partial) = self.cache.start(&self.place, self.bytes)? else {
            return Ok(false);
        };
        let weights = self.stamp.path.to_string_lossy().into_owned();
        packed_file::write(&partial.file, (weights, self.identity), &self.packed)?;
        // What was packed is of that state only if it is the same at the end.
        if !self.stamp.is_current() {
            return Err(Refusal::Checkpoint);
        }
        partial.finish()?;
        Ok(true)
    }
}
