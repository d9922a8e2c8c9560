//! The latents of all frames of a [`Dataset`], encoded once by the frozen encoder and kept in one memory-mapped file of
//! 16-bit floats.
//!
//! The cache is keyed by the dataset's digest and by the latent space: other frames or another encoder make a new one.

use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use half::f16;
use indicatif::{ProgressBar, ProgressStyle};
use memmap2::Mmap;
use rayon::prelude::*;
use wm_model::{Encoder, LatentSpace};
use wm_motion::actions::ActionSpace;

use crate::dataset::{Dataset, Episode};

/// Frames that are encoded at once: bounds the memory.
const BATCH: usize = 16;

/// Latents of episodes, in the order of their frames.
#[derive(Debug)]
pub struct Latents {
    space: LatentSpace,
    episodes: Vec<Episode>,
    digest: String,
    actions: ActionSpace,
    values: Mmap,
}

impl Latents {
    /// The latents of `dataset`: encoded now, or taken from `cache_dir` where an earlier call has left them.
    ///
    /// # Errors
    /// When a frame cannot be encoded, or the cache cannot be read or written.
    pub fn open(dataset: &Dataset, encoder: &dyn Encoder, cache_dir: &Path) -> Result<Self> {
        let space = encoder.space().clone();
        let short = |digest: &str| digest.chars().take(16).collect::<String>();
        let name = format!("latents-{}-{}", short(dataset.digest()), short(&space.hash));
        let path = cache_dir.join(name);
        if !path.is_file() {
            encode(dataset, encoder, &path)?;
        }
        Self::map(
            &path,
            space,
            dataset.episodes().to_vec(),
            dataset.digest().to_owned(),
            dataset.action_space().clone(),
        )
    }

    /// Maps the file of the latents of `episodes`.
    pub(crate) fn map(
        path: &Path,
        space: LatentSpace,
        episodes: Vec<Episode>,
        digest: String,
        actions: ActionSpace,
    ) -> Result<Self> {
        let file = File::open(path).with_context(|| path.display().to_string())?;
        // SAFETY: the cache is this program's own; whoever changes it during a training breaks only their own run.
        let values = unsafe { Mmap::map(&file) }.with_context(|| path.display().to_string())?;
        let frames: usize = episodes.iter().map(|episode| episode.frame_count).sum();
        let expected = frames * space.elements() * size_of::<f16>();
        ensure!(
            values.len() == expected,
            "{}: expected {expected} bytes, found {}; remove the file to recompute it",
            path.display(),
            values.len()
        );
        Ok(Self {
            space,
            episodes,
            digest,
            actions,
            values,
        })
    }

    /// The space that the latents are in.
    #[must_use]
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// The episodes, in the order of their frames.
    #[must_use]
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// What the actions of its episodes are.
    #[must_use]
    pub fn action_space(&self) -> &ActionSpace {
        &self.actions
    }

    /// Digest of the frames that the latents are of.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Appends the latent of frame `index`, in row-major order, to `out`.
    ///
    /// # Errors
    /// When there is no such frame.
    pub fn read(&self, index: usize, out: &mut Vec<f32>) -> Result<()> {
        let bytes = self.space.elements() * size_of::<f16>();
        let latent = self
            .values
            .get(index * bytes..(index + 1) * bytes)
            .with_context(|| format!("no frame {index}"))?;
        let (values, _) = latent.as_chunks::<2>();
        out.extend(
            values
                .iter()
                .map(|value| f16::from_le_bytes(*value).to_f32()),
        );
        Ok(())
    }
}

fn encode(dataset: &Dataset, encoder: &dyn Encoder, path: &Path) -> Result<()> {
    let (height, width) = dataset.size();
    ensure!(
        encoder.input_size() == (height, width),
        "frames of {height}x{width} for an encoder of {:?}",
        encoder.input_size()
    );
    let total = dataset.frame_count();
    let elements = encoder.space().elements();
    let style = ProgressStyle::with_template("encoding {bar:40} {pos}/{len} frames, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let progress = ProgressBar::new(total as u64).with_style(style);
    let partial = partial(path);
    let mut file =
        BufWriter::new(File::create(&partial).with_context(|| partial.display().to_string())?);
    let firsts: Vec<usize> = (0..total).step_by(BATCH).collect();
    // A batch a thread at a time: parallel, in order, and bounded in memory.
    for group in firsts.chunks(rayon::current_num_threads()) {
        let encoded = group
            .par_iter()
            .map(|first| encode_batch(dataset, encoder, *first, BATCH.min(total - first)))
            .collect::<Result<Vec<_>>>()?;
        for latents in encoded {
            file.write_all(&latents)?;
            progress.inc((latents.len() / size_of::<f16>() / elements) as u64);
        }
    }
    file.flush()?;
    progress.finish_and_clear();
    // In one move, so that a file of this name is whole.
    fs::rename(&partial, path).with_context(|| path.display().to_string())
}

/// The latents of `count` frames from `first` on, as the cache holds them.
fn encode_batch(
    dataset: &Dataset,
    encoder: &dyn Encoder,
    first: usize,
    count: usize,
) -> Result<Vec<u8>> {
    let (height, width) = dataset.size();
    let mut pixels = Vec::with_capacity(count * height * width * 3);
    for index in first..first + count {
        let frame = dataset
            .frame(index)
            .with_context(|| format!("no frame {index}"))?;
        pixels.extend(frame.iter().map(|value| f32::from(*value) / 255.0));
    }
    let images = Tensor::from_vec(pixels, (count, height, width, 3), &Device::Cpu)?;
    let latents = encoder.encode(&images)?.flatten_all()?.to_vec1::<f32>()?;
    ensure!(
        latents.iter().all(|value| value.is_finite()),
        "a latent of the frames {first} to {} is not finite",
        first + count - 1
    );
    Ok(latents
        .into_iter()
        .flat_map(|value| f16::from_f32(value).to_le_bytes())
        .collect())
}

fn partial(path: &Path) -> PathBuf {
    path.with_extension("partial")
}
