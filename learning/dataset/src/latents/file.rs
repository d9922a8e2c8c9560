use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use half::f16;
use memmap2::Mmap;
use rayon::prelude::*;
use wm_bag::Shard;
use wm_model::{Encoder, LatentSpace};
use wm_program::progress::Progress;

use super::part::{Part, expect_length};
use crate::{Folder, short};

/// Frames encoded at once: bounds the memory. An encoder's rounding may depend on it, so parts use the same batches as
/// the whole.
const BATCH: usize = 16;

/// The file with the latents of all frames of a folder, existing or not.
pub(super) struct LatentFile<'a> {
    folder: &'a Folder,
    encoder: &'a dyn Encoder,
    path: PathBuf,
}

impl<'a> LatentFile<'a> {
    /// In the prepared folder if it exists there, else in the cache.
    pub fn new(folder: &'a Folder, encoder: &'a dyn Encoder, cache_dir: &Path) -> Self {
        let digest = short(&folder.manifest().digest);
        let name = format!("latents-{digest}-{}", short(&encoder.space().hash));
        let prepared = folder.dir().join(&name);
        let path = if prepared.is_file() {
            prepared
        } else {
            cache_dir.join(name)
        };
        Self {
            folder,
            encoder,
            path,
        }
    }

    /// Maps the file; creates it first from parts and new latents if missing.
    pub fn open(&self) -> Result<Mmap> {
        if !self.path.is_file() {
            self.join()?;
        }
        map(&self.path, self.folder.frame_count(), self.encoder.space())
    }

    /// Encodes a shard's frames into a part, unless they exist. Returns their file; `None` for an empty shard.
    pub fn encode_shard(&self, shard: Shard) -> Result<Option<PathBuf>> {
        let total = self.folder.frame_count();
        let batches = shard.range_of(total.div_ceil(BATCH));
        let frames = batches.start * BATCH..total.min(batches.end * BATCH);
        if batches.is_empty() {
            return Ok(None);
        }
        if self.path.is_file() {
            self.open()?;
            return Ok(Some(self.path.clone()));
        }
        let parts = self.parts()?;
        let path = Part::path_of(&self.path, &frames);
        if !parts.iter().any(|part| part.path() == path) {
            self.write(&path, frames, &parts)?;
        }
        Ok(Some(path))
    }

    fn join(&self) -> Result<()> {
        let parts = self.parts()?;
        // Another program may have joined and removed them.
        if self.path.is_file() {
            return Ok(());
        }
        self.write(&self.path, 0..self.folder.frame_count(), &parts)?;
        parts.iter().for_each(Part::remove);
        Ok(())
    }

    fn parts(&self) -> Result<Vec<Part>> {
        let frame_bytes = frame_bytes(self.encoder.space());
        Part::find_all(&self.path, self.folder.frame_count(), frame_bytes)
    }

    /// Writes the latents of frames that start at a batch.
    fn write(&self, path: &Path, frames: Range<usize>, parts: &[Part]) -> Result<()> {
        let progress = Progress::of("encoding", "frames", frames.len() as u64);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        }
        // Two programs may write the same file, with equal process ids on two machines.
        let mut partial = path.as_os_str().to_owned();
        partial.push(format!(".partial-{:016x}", rand::random::<u64>()));
        let partial = PathBuf::from(partial);
        let mut file =
            BufWriter::new(File::create(&partial).with_context(|| partial.display().to_string())?);
        let firsts = frames.clone().step_by(BATCH);
        let batches: Vec<Range<usize>> = firsts
            .map(|first| first..frames.end.min(first + BATCH))
            .collect();
        // One batch per thread at a time: parallel, ordered, and bounded in memory.
        for group in batches.chunks(rayon::current_num_threads()) {
            let latents = group.par_iter().map(|batch| self.latents(batch, parts));
            let latents = latents.collect::<Result<Vec<_>>>()?;
            for (batch, latents) in group.iter().zip(latents) {
                file.write_all(&latents)?;
                progress.inc(batch.len() as u64);
            }
        }
        file.flush()?;
        drop(progress);
        // An atomic rename: a file of this name is complete.
        fs::rename(&partial, path).with_context(|| path.display().to_string())
    }

    /// Stored bytes of a batch, from a part that has all of it, or encoded now.
    fn latents(&self, batch: &Range<usize>, parts: &[Part]) -> Result<Vec<u8>> {
        let part = parts.iter().find(|part| part.has(batch));
        part.map_or_else(|| self.encode(batch), |part| part.read(batch))
    }

    fn encode(&self, batch: &Range<usize>) -> Result<Vec<u8>> {
        let (height, width) = self.encoder.input_size();
        let mut pixels = Vec::with_capacity(batch.len() * height * width * 3);
        for index in batch.clone() {
            let frame = self.folder.frame(index);
            let frame = frame.with_context(|| format!("no frame {index}"))?;
            pixels.extend(frame.iter().map(|value| f32::from(*value) / 255.0));
        }
        let images = Tensor::from_vec(pixels, (batch.len(), height, width, 3), &Device::Cpu)?;
        let latents = self.encoder.encode(&images)?.flatten_all()?;
        let latents = latents.to_vec1::<f32>()?;
        ensure!(
            latents.iter().all(|value| value.is_finite()),
            "a latent of the frames {} to {} is not finite",
            batch.start,
            batch.end.saturating_sub(1)
        );
        Ok(latents
            .into_iter()
            .flat_map(|value| f16::from_f32(value).to_le_bytes())
            .collect())
    }
}

/// Maps a file of `frames` frames.
pub(super) fn map(path: &Path, frames: usize, space: &LatentSpace) -> Result<Mmap> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    // SAFETY: the cache belongs to this program; changing it during a training breaks only that run.
    let values = unsafe { Mmap::map(&file) }.with_context(|| path.display().to_string())?;
    expect_length(path, frames * frame_bytes(space), values.len() as u64)?;
    Ok(values)
}

fn frame_bytes(space: &LatentSpace) -> usize {
    space.elements() * size_of::<f16>()
}
