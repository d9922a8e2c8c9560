//! The latents of all frames of a [`Dataset`], encoded once by the frozen encoder and stored as 16-bit floats in a
//! memory-mapped file.
//!
//! The key of the cache is the digest of the frames and the latent space. Several machines may each encode a part of
//! the frames.

mod file;
mod part;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};
use half::f16;
use memmap2::Mmap;
use rayon::prelude::*;
use wm_bag::Shard;
use wm_model::{Encoder, LatentSpace, PictureSize};
use wm_motion::actions::ActionSpace;

use crate::{Dataset, Episode, LatentStatistics, Layout};
use file::LatentFile;
#[cfg(any(test, feature = "testing"))]
use file::map;

/// Latents of episodes, by frame.
#[derive(Debug)]
pub struct Latents {
    space: LatentSpace,
    layout: Layout,
    digest: String,
    actions: ActionSpace,
    views: usize,
    picture_size: Option<PictureSize>,
    files: Vec<Mmap>,
}

impl Latents {
    /// The latents of `dataset`, from `cache_dir`, from a prepared folder, or encoded now. Parts from
    /// [`encode_shard`](Self::encode_shard) in `cache_dir` are joined and removed. All frames of a folder are encoded,
    /// so that other splits find their latents too.
    ///
    /// # Errors
    /// If a frame cannot be encoded, or the cache cannot be read or written.
    pub fn open(dataset: &Dataset, encoder: &dyn Encoder, cache_dir: &Path) -> Result<Self> {
        let files = latent_files(dataset, encoder, cache_dir)?;
        let files = files.iter().map(LatentFile::open);
        Ok(Self {
            files: files.collect::<Result<_>>()?,
            space: encoder.space().clone(),
            layout: dataset.layout().clone(),
            digest: dataset.digest().to_owned(),
            actions: dataset.action_space().clone(),
            views: dataset.views(),
            picture_size: dataset.picture_size(),
        })
    }

    /// Encodes a shard of each folder's frames, unless `cache_dir` has them. Returns the files; none if there are fewer
    /// batches than shards.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn encode_shard(
        dataset: &Dataset,
        encoder: &dyn Encoder,
        cache_dir: &Path,
        shard: Shard,
    ) -> Result<Vec<PathBuf>> {
        let files = latent_files(dataset, encoder, cache_dir)?;
        let parts = files.iter().map(|file| file.encode_shard(shard));
        parts.filter_map(Result::transpose).collect()
    }

    /// The latents of `episodes` in one file.
    ///
    /// # Errors
    /// If the file cannot be read, or has another length.
    #[cfg(any(test, feature = "testing"))]
    pub fn map(
        path: &Path,
        space: LatentSpace,
        episodes: Vec<Episode>,
        digest: String,
        actions: ActionSpace,
    ) -> Result<Self> {
        let mut layout = Layout::default();
        for episode in &episodes {
            layout.push(0, episode);
        }
        Ok(Self {
            files: vec![map(path, layout.frame_count(), &space)?],
            space,
            layout,
            digest,
            actions,
            views: 1,
            picture_size: None,
        })
    }

    /// Latent space.
    #[must_use]
    pub fn space(&self) -> &LatentSpace {
        &self.space
    }

    /// Episodes by frame.
    #[must_use]
    pub fn episodes(&self) -> &[Episode] {
        self.layout.episodes()
    }

    /// Space of the episodes' actions.
    #[must_use]
    pub fn action_space(&self) -> &ActionSpace {
        &self.actions
    }

    /// Number of cameras, side by side in a frame.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views
    }

    /// [`Dataset::picture_size`] of the frames.
    #[must_use]
    pub fn picture_size(&self) -> Option<PictureSize> {
        self.picture_size
    }

    /// Sets the number of cameras.
    #[must_use]
    #[cfg(any(test, feature = "testing"))]
    pub fn of_views(self, views: usize) -> Self {
        Self { views, ..self }
    }

    /// Digest of the encoded frames.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Appends the latent of frame `index` to `out`, row-major.
    ///
    /// # Errors
    /// For an unknown index.
    pub fn read(&self, index: usize, out: &mut Vec<f32>) -> Result<()> {
        let bytes = self.space.elements() * size_of::<f16>();
        let latent = self.layout.locate(index).and_then(|(file, frame)| {
            let values = self.files.get(file)?;
            values.get(frame * bytes..(frame + 1) * bytes)
        });
        let (values, _) = latent
            .with_context(|| format!("no frame {index}"))?
            .as_chunks::<2>();
        out.extend(
            values
                .iter()
                .map(|value| f16::from_le_bytes(*value).to_f32()),
        );
        Ok(())
    }

    /// Mean and standard deviation of each channel over all frames.
    ///
    /// # Errors
    /// Without frames.
    pub fn statistics(&self) -> Result<LatentStatistics> {
        let channels = self.space.channels;
        let frames = self.layout.frame_count();
        ensure!(frames > 0, "there are no latents");
        // Sums and sums of squares per channel in f64: latents are near 1, so nothing cancels.
        let sums = (0..frames).into_par_iter().try_fold(
            || vec![(0.0_f64, 0.0_f64); channels],
            |mut sums, frame| -> Result<_> {
                let mut latent = Vec::with_capacity(self.space.elements());
                self.read(frame, &mut latent)?;
                for cell in latent.chunks_exact(channels) {
                    for ((sum, squares), value) in sums.iter_mut().zip(cell) {
                        let value = f64::from(*value);
                        *sum += value;
                        *squares += value * value;
                    }
                }
                Ok(sums)
            },
        );
        let sums = sums.try_reduce(
            || vec![(0.0, 0.0); channels],
            |mut a, b| {
                for (a, b) in a.iter_mut().zip(b) {
                    *a = (a.0 + b.0, a.1 + b.1);
                }
                Ok(a)
            },
        )?;
        let n = (frames * self.space.elements() / channels) as f64;
        let mean = |(sum, _): &(f64, f64)| sum / n;
        let std = |sums: &(f64, f64)| (sums.1 / n - mean(sums).powi(2)).max(0.0).sqrt();
        Ok(LatentStatistics {
            space: self.space.to_string(),
            mean: sums.iter().map(mean).collect(),
            std: sums.iter().map(std).collect(),
            count: frames as u64,
        })
    }
}

/// The files of a data set's folders.
fn latent_files<'a>(
    dataset: &'a Dataset,
    encoder: &'a dyn Encoder,
    cache_dir: &Path,
) -> Result<Vec<LatentFile<'a>>> {
    ensure!(
        encoder.input_size() == dataset.size(),
        "frames of {:?} for an encoder of {:?} (height, width)",
        dataset.size(),
        encoder.input_size()
    );
    let (own, taken) = (dataset.framing().fit, encoder.framing().fit);
    ensure!(
        own == taken,
        "frames of fit {own} for an encoder of fit {taken}"
    );
    let folders = dataset.folders().iter();
    let files = folders.map(|folder| LatentFile::new(folder, encoder, cache_dir));
    Ok(files.collect())
}

#[cfg(test)]
mod tests;
