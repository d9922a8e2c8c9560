//! The latents of all frames of a [`Dataset`], encoded once by the frozen encoder and kept in one memory-mapped file of
//! 16-bit floats.
//!
//! The cache is keyed by the digest of the frames and by the latent space: other frames or another encoder make a new one.

use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    path::Path,
};

use anyhow::{Context as _, Result, ensure};
use candle_core::{Device, Tensor};
use half::f16;
use memmap2::Mmap;
use rayon::prelude::*;
use wm_model::{Encoder, LatentSpace};
use wm_motion::actions::ActionSpace;

use crate::{Dataset, Episode, Folder, LatentStatistics, Layout, progress_bar, short};

/// Frames that are encoded at once: bounds the memory.
const BATCH: usize = 16;

/// Latents of episodes, in the order of their frames.
#[derive(Debug)]
pub struct Latents {
    space: LatentSpace,
    layout: Layout,
    digest: String,
    actions: ActionSpace,
    views: usize,
    files: Vec<Mmap>,
}

impl Latents {
    /// The latents of `dataset`: encoded now, or taken from `cache_dir`, or a prepared folder, where an earlier call has left
    /// them. All frames of a folder are encoded, so that another choice of its episodes finds its latents too.
    ///
    /// # Errors
    /// When a frame cannot be encoded, or the cache cannot be read or written.
    pub fn open(dataset: &Dataset, encoder: &dyn Encoder, cache_dir: &Path) -> Result<Self> {
        let space = encoder.space().clone();
        ensure!(
            encoder.input_size() == dataset.size(),
            "frames of {:?} for an encoder of {:?} (height, width)",
            dataset.size(),
            encoder.input_size()
        );
        let mut files = Vec::new();
        for folder in dataset.folders() {
            let digest = short(&folder.manifest().digest);
            let name = format!("latents-{digest}-{}", short(&space.hash));
            let prepared = folder.dir().join(&name);
            let path = if prepared.is_file() {
                prepared
            } else {
                cache_dir.join(name)
            };
            if !path.is_file() {
                encode(folder, dataset.size(), encoder, &path)?;
            }
            files.push(map(&path, folder.frame_count(), &space)?);
        }
        Ok(Self {
            space,
            layout: dataset.layout().clone(),
            digest: dataset.digest().to_owned(),
            actions: dataset.action_space().clone(),
            views: dataset.views(),
            files,
        })
    }

    /// The latents of `episodes` in one file.
    ///
    /// # Errors
    /// If the file cannot be read, or has not their length.
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
        self.layout.episodes()
    }

    /// What the actions of its episodes are.
    #[must_use]
    pub fn action_space(&self) -> &ActionSpace {
        &self.actions
    }

    /// Number of cameras, whose pictures lie side by side in a frame.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views
    }

    /// The same, said to be of so many cameras.
    #[must_use]
    #[cfg(any(test, feature = "testing"))]
    pub fn of_views(self, views: usize) -> Self {
        Self { views, ..self }
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
    /// When there is no frame.
    pub fn statistics(&self) -> Result<LatentStatistics> {
        let channels = self.space.channels;
        let frames = self.layout.frame_count();
        ensure!(frames > 0, "there are no latents");
        // Per channel sum and sum of squares: latents are of the order of 1, so that nothing
        // cancels in double precision.
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

fn map(path: &Path, frames: usize, space: &LatentSpace) -> Result<Mmap> {
    let file = File::open(path).with_context(|| path.display().to_string())?;
    // SAFETY: the cache is this program's own; whoever changes it during a training breaks only their own run.
    let values = unsafe { Mmap::map(&file) }.with_context(|| path.display().to_string())?;
    let expected = frames * space.elements() * size_of::<f16>();
    ensure!(
        values.len() == expected,
        "{}: expected {expected} bytes, found {}; remove the file to recompute it",
        path.display(),
        values.len()
    );
    Ok(values)
}

fn encode(folder: &Folder, size: (usize, usize), encoder: &dyn Encoder, path: &Path) -> Result<()> {
    let total = folder.frame_count();
    let elements = encoder.space().elements();
    let progress = progress_bar("encoding", "frames", total);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    // Two programs may encode the same.
    let partial = path.with_extension(format!("partial-{}", std::process::id()));
    let mut file =
        BufWriter::new(File::create(&partial).with_context(|| partial.display().to_string())?);
    let firsts: Vec<usize> = (0..total).step_by(BATCH).collect();
    // A batch a thread at a time: parallel, in order, and bounded in memory.
    for group in firsts.chunks(rayon::current_num_threads()) {
        let encoded = group
            .par_iter()
            .map(|first| encode_batch(folder, size, encoder, *first, BATCH.min(total - first)))
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
    folder: &Folder,
    (height, width): (usize, usize),
    encoder: &dyn Encoder,
    first: usize,
    count: usize,
) -> Result<Vec<u8>> {
    let mut pixels = Vec::with_capacity(count * height * width * 3);
    for index in first..first + count {
        let frame = folder
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

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use wm_model::Result;

    use super::*;
    use crate::{Data, DataOptions};

    /// Two channels: the red of each pixel, and 0.5.
    struct Red(LatentSpace);

    impl Encoder for Red {
        fn space(&self) -> &LatentSpace {
            &self.0
        }

        fn input_size(&self) -> (usize, usize) {
            (16, 16)
        }

        fn encode(&self, images: &Tensor) -> Result<Tensor> {
            let red = images.narrow(3, 0, 1)?;
            let half = (red.zeros_like()? + 0.5)?;
            Ok(Tensor::cat(&[red, half], 3)?)
        }
    }

    #[test]
    fn another_split_finds_its_latents_and_their_statistics_are_right() {
        let dir = tempfile::tempdir().unwrap();
        let bags = dir.path().join("bags");
        let frames = |name: &str, reds: &[u8]| {
            crate::testing::write_reds(&bags.join(name), reds);
        };
        frames("a", &[0, 255, 0, 255]);
        frames("b", &[51, 51, 51]);
        let cache = dir.path().join("cache");
        let space = LatentSpace {
            name: "red".into(),
            hash: "00".into(),
            height: 16,
            width: 16,
            channels: 2,
        };
        let encoder = Red(space);
        let mut made: Vec<PathBuf> = Vec::new();
        for seed in 0..4 {
            let options = DataOptions {
                validation: Some(0.5),
                validation_seed: Some(seed),
                ..DataOptions::default()
            };
            let data = Data::open(std::slice::from_ref(&bags), (16, 16), &cache, &options).unwrap();
            let latents = Latents::open(&data.training, &encoder, &cache).unwrap();
            let statistics = latents.statistics().unwrap();
            let (mean, std) = match latents.episodes()[0].name.as_str() {
                "a" => (0.5, 0.5),
                _ => (0.2, 0.0),
            };
            // As exact as 16-bit numbers.
            assert!((statistics.mean[0] - mean).abs() < 1e-3, "{statistics:?}");
            assert!((statistics.std[0] - std).abs() < 1e-3, "{statistics:?}");
            assert_eq!((statistics.mean[1], statistics.std[1]), (0.5, 0.0));
            let entries = fs::read_dir(&cache).unwrap();
            let mut found: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
            found.sort();
            assert!(made.is_empty() || made == found, "{found:?}");
            made = found;
        }
    }
}
