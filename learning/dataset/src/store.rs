//! A prepared folder: `frames` (height x width x 3 bytes each), `masks` (height x width bytes each, if any), `actions`
//! (little-endian f32), `statistics.json`, `action_space.json`, `audit.json` and `dataset.json`.

use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
};

use image::{GrayImage, RgbImage};
use memmap2::Mmap;
use rayon::prelude::*;
use serde::Serialize;
use sha2::{Digest as _, Sha256};
use wm_audit::Audit;

use super::{
    DataStatistics, DatasetError, Episode, LatentStatistics, Manifest, Size,
    fingerprint::{hex, short},
    manifest::VERSION,
    mask::shrink,
};

const MANIFEST: &str = "dataset.json";
const AUDIT: &str = "audit.json";
/// The action space with fitted scales.
pub(super) const ACTION_SPACE: &str = "action_space.json";

/// Whether a folder was prepared by `wm dataset`.
pub(super) fn is_prepared(dir: &Path) -> bool {
    dir.join(MANIFEST).is_file()
}

/// An open prepared folder.
#[derive(Debug)]
pub(crate) struct Folder {
    dir: PathBuf,
    manifest: Manifest,
    episodes: Vec<Episode>,
    frames: Mmap,
    masks: Option<Mmap>,
}

impl Folder {
    /// # Errors
    /// If a file is missing, damaged, or of a length other than in the manifest.
    pub fn open(dir: &Path) -> Result<Self, DatasetError> {
        let manifest = read_manifest(dir)?;
        let total: usize = manifest.episodes.iter().map(|e| e.frames).sum();
        let Size { height, width } = manifest.size;
        let pixels = total * height * width;
        let frames = map(&dir.join("frames"), pixels * 3 * manifest.cameras.len())?;
        let masks = match manifest.has_masks {
            true => Some(map(&dir.join("masks"), pixels)?),
            false => None,
        };
        let values = manifest.action_space.len();
        let actions = map(&dir.join("actions"), total * values * size_of::<f32>())?;
        let rows = actions.chunks_exact(values * size_of::<f32>()).map(|row| {
            let (values, _) = row.as_chunks::<4>();
            values
                .iter()
                .map(|value| f32::from_le_bytes(*value))
                .collect()
        });
        Ok(Self {
            dir: dir.to_owned(),
            episodes: Self::episodes(&manifest, rows),
            manifest,
            frames,
            masks,
        })
    }

    /// The episodes of a manifest, with the action of each frame.
    pub fn episodes(
        manifest: &Manifest,
        mut actions: impl Iterator<Item = Vec<f32>>,
    ) -> Vec<Episode> {
        let mut first_frame = 0;
        let listed = manifest.episodes.iter().map(|listed| {
            let episode = Episode {
                name: listed.name.clone(),
                first_frame,
                frame_count: listed.frames,
                actions: actions.by_ref().take(listed.frames).collect(),
                instruction: listed.instruction.clone(),
                success: listed.success,
                labels: listed.labels.clone(),
            };
            first_frame += listed.frames;
            episode
        });
        listed.collect()
    }

    pub fn dir(&self) -> &Path {
        &self.dir
    }

    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Its episodes, with frame indices of this folder.
    pub fn all_episodes(&self) -> &[Episode] {
        &self.episodes
    }

    pub fn frame_count(&self) -> usize {
        self.manifest.episodes.iter().map(|e| e.frames).sum()
    }

    /// Number of cameras.
    pub fn views(&self) -> usize {
        self.manifest.cameras.len()
    }

    /// Height x (views x width) x 3 bytes.
    pub fn frame(&self, index: usize) -> Option<&[u8]> {
        let Size { height, width } = self.manifest.size;
        let bytes = height * width * self.views() * 3;
        self.frames.get(index * bytes..(index + 1) * bytes)
    }

    /// Height x width bytes.
    pub fn mask(&self, index: usize) -> Option<&[u8]> {
        let Size { height, width } = self.manifest.size;
        let bytes = height * width;
        self.masks.as_ref()?.get(index * bytes..(index + 1) * bytes)
    }

    /// A folder with smaller pictures, made now or reused from `cache`.
    ///
    /// # Errors
    /// [`DatasetError::Upscaling`] for larger pictures.
    pub fn at_size(self, size: Size, cache: &Path) -> Result<Self, DatasetError> {
        let stored = self.manifest.size;
        if stored == size {
            return Ok(self);
        }
        if stored.height < size.height || stored.width < size.width {
            return Err(DatasetError::Upscaling {
                dir: self.dir,
                stored: (stored.height, stored.width),
                requested: (size.height, size.width),
            });
        }
        let hash = Sha256::new().chain_update(format!("{} {size}", self.manifest.digest));
        let manifest = Manifest {
            digest: hex(hash),
            size,
            ..self.manifest.clone()
        };
        let dir = cache.join(cache_name(&manifest.digest));
        if !is_prepared(&dir) {
            let folder = NewFolder::create(&dir)?;
            self.resize(&manifest, &folder)?;
            for name in ["actions", "statistics.json", ACTION_SPACE, AUDIT] {
                let (from, to) = (self.dir.join(name), folder.partial.join(name));
                // Folders older than the audit have none.
                if name == AUDIT && !from.exists() {
                    continue;
                }
                fs::copy(&from, &to).map_err(DatasetError::io(&from))?;
            }
            folder
                .finish(&manifest)
                .or_else(if_another_was_first(&dir))?;
        }
        Self::open(&dir)
    }

    fn resize(&self, manifest: &Manifest, folder: &NewFolder) -> Result<(), DatasetError> {
        let (from, to) = (self.manifest.size, manifest.size);
        let (views, frame_bytes) = (self.views(), to.height * to.width * self.views() * 3);
        let (frames, path) = folder.create_file("frames")?;
        (0..self.frame_count())
            .into_par_iter()
            .try_for_each(|index| {
                let frame = self
                    .frame(index)
                    .ok_or_else(|| self.damaged(format!("frame {index} is missing")))?;
                let mut resized = vec![0; frame_bytes];
                for view in 0..views {
                    let rows = frame.chunks_exact(from.width * 3).skip(view).step_by(views);
                    let pixels: Vec<u8> = rows.flatten().copied().collect();
                    let small = picture(pixels, from)
                        .and_then(|view| wm_model::image::resize(&view, (to.height, to.width)).ok())
                        .ok_or_else(|| self.damaged(format!("frame {index} cannot be resized")))?;
                    let targets = resized.chunks_exact_mut(to.width * 3);
                    let rows = small.as_raw().chunks_exact(to.width * 3);
                    for (target, row) in targets.skip(view).step_by(views).zip(rows) {
                        target.copy_from_slice(row);
                    }
                }
                let at = index * frame_bytes;
                frames
                    .write_all_at(&resized, at as u64)
                    .map_err(DatasetError::io(&path))
            })?;
        if self.masks.is_none() {
            return Ok(());
        }
        let (masks, path) = folder.create_file("masks")?;
        (0..self.frame_count())
            .into_par_iter()
            .try_for_each(|index| {
                let mask = self
                    .mask(index)
                    .ok_or_else(|| self.damaged(format!("mask {index} is missing")))?
                    .to_vec();
                let mask = GrayImage::from_raw(from.width as u32, from.height as u32, mask)
                    .ok_or_else(|| self.damaged(format!("mask {index} cannot be resized")))?;
                let small = shrink(&mask, to);
                let at = index * to.height * to.width;
                masks
                    .write_all_at(small.as_raw(), at as u64)
                    .map_err(DatasetError::io(&path))
            })
    }

    fn damaged(&self, what: String) -> DatasetError {
        DatasetError::Prepared {
            dir: self.dir.clone(),
            what,
        }
    }
}

fn picture(pixels: Vec<u8>, size: Size) -> Option<RgbImage> {
    // A side is at most 4096.
    RgbImage::from_raw(size.width as u32, size.height as u32, pixels)
}

/// Name of the cache folder for a digest.
pub(super) fn cache_name(digest: &str) -> String {
    format!("frames-{}", short(digest))
}

/// If two programs prepare the same data at once, the first result serves both.
pub(super) fn if_another_was_first(
    dir: &Path,
) -> impl FnOnce(DatasetError) -> Result<(), DatasetError> {
    move |error| if is_prepared(dir) { Ok(()) } else { Err(error) }
}

pub(super) fn read_manifest(dir: &Path) -> Result<Manifest, DatasetError> {
    let path = dir.join(MANIFEST);
    let text = fs::read(&path).map_err(DatasetError::io(&path))?;
    let prepared = |what: String| DatasetError::Prepared {
        dir: dir.to_owned(),
        what,
    };
    let damaged = |error: serde_json::Error| prepared(format!("{MANIFEST}: {error}"));
    // Check the version first: others may have other fields.
    let value: serde_json::Value = serde_json::from_slice(&text).map_err(damaged)?;
    let version = value.get("version").and_then(serde_json::Value::as_u64);
    if version != Some(u64::from(VERSION)) {
        let version = version.map_or("none".to_owned(), |version| version.to_string());
        return Err(prepared(format!(
            "{MANIFEST}: expected version {VERSION}, found {version}; prepare the bags again"
        )));
    }
    let manifest: Manifest = serde_json::from_value(value).map_err(damaged)?;
    let total = manifest
        .episodes
        .iter()
        .try_fold(0_usize, |total, episode| total.checked_add(episode.frames));
    let views = manifest.cameras.len();
    let most = total.and_then(|total| total.checked_mul(manifest.size.height));
    let most = most.and_then(|most| most.checked_mul(manifest.size.width * 3 * views.max(1)));
    if views == 0 || most.is_none() {
        return Err(prepared(format!(
            "{MANIFEST}: expected at least one camera, and an addressable size of frames"
        )));
    }
    Ok(manifest)
}

/// The audit of a prepared folder; `None` if prepared before audits existed.
pub(super) fn read_audit(dir: &Path) -> Result<Option<Audit>, DatasetError> {
    let path = dir.join(AUDIT);
    let text = match fs::read(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(DatasetError::io(&path)(error)),
    };
    let audit = serde_json::from_slice(&text).map_err(|error| DatasetError::file(&path, error))?;
    Ok(Some(audit))
}

fn map(path: &Path, expected: usize) -> Result<Mmap, DatasetError> {
    let file = File::open(path).map_err(DatasetError::io(path))?;
    // SAFETY: a prepared folder is never rewritten; changing it during a training breaks only that run.
    let map = unsafe { Mmap::map(&file) }.map_err(DatasetError::io(path))?;
    if map.len() == expected {
        return Ok(map);
    }
    let what = format!(
        "expected {expected} bytes, found {}; remove the folder and prepare the bags again",
        map.len()
    );
    Err(DatasetError::file(path, what))
}

/// A folder under construction, beside its final place. It moves there when complete, and is removed otherwise; the
/// remains of a killed program have another name than any data set.
pub(super) struct NewFolder {
    partial: PathBuf,
    dir: PathBuf,
}

impl NewFolder {
    pub fn create(dir: &Path) -> Result<Self, DatasetError> {
        // Only a path such as `..` has no name; the random suffix keeps it unique.
        let name = dir.file_name().unwrap_or_default().to_string_lossy();
        // Two threads or machines may prepare the same data with equal process ids.
        let name = format!("{name}.partial-{:016x}", rand::random::<u64>());
        let partial = dir.with_file_name(name);
        fs::create_dir_all(&partial).map_err(DatasetError::io(&partial))?;
        Ok(Self {
            partial,
            dir: dir.to_owned(),
        })
    }

    pub fn create_file(&self, name: &str) -> Result<(File, PathBuf), DatasetError> {
        let path = self.partial.join(name);
        let file = File::create_new(&path).map_err(DatasetError::io(&path))?;
        Ok((file, path))
    }

    pub fn write_actions(&self, actions: &[Vec<f32>]) -> Result<(), DatasetError> {
        let (file, path) = self.create_file("actions")?;
        let mut file = BufWriter::new(file);
        for value in actions.iter().flatten() {
            file.write_all(&value.to_le_bytes())
                .map_err(DatasetError::io(&path))?;
        }
        file.flush().map_err(DatasetError::io(&path))
    }

    pub fn write_statistics(&self, statistics: &DataStatistics) -> Result<(), DatasetError> {
        self.write_json("statistics.json", statistics)?;
        self.write_json(ACTION_SPACE, &statistics.action_space)
    }

    pub fn write_audit(&self, audit: &Audit) -> Result<(), DatasetError> {
        self.write_json(AUDIT, audit)
    }

    fn write_json(&self, name: &str, value: &impl Serialize) -> Result<(), DatasetError> {
        let path = self.partial.join(name);
        let text = serde_json::to_vec_pretty(value);
        let text = text.map_err(|error| DatasetError::file(&path, error))?;
        fs::write(&path, text).map_err(DatasetError::io(&path))
    }

    /// Moves the folder to its place.
    pub fn finish(self, manifest: &Manifest) -> Result<(), DatasetError> {
        self.write_json(MANIFEST, manifest)?;
        for entry in fs::read_dir(&self.partial).map_err(DatasetError::io(&self.partial))? {
            let path = entry.map_err(DatasetError::io(&self.partial))?.path();
            // Without the sync, a power cut might keep the name and lose the contents.
            let file = File::open(&path).and_then(|file| file.sync_all());
            file.map_err(DatasetError::io(&path))?;
        }
        if self.dir.exists() {
            return Err(DatasetError::Exists(self.dir.clone()));
        }
        fs::rename(&self.partial, &self.dir).map_err(DatasetError::io(&self.dir))
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        // After the move nothing is left. If removal fails, the name identifies the remains.
        let _ = fs::remove_dir_all(&self.partial);
    }
}

/// Adds latent statistics to a prepared folder.
pub(super) fn add_latent_statistics(
    dir: &Path,
    latent: LatentStatistics,
) -> Result<(), DatasetError> {
    let path = dir.join("statistics.json");
    let text = fs::read(&path).map_err(DatasetError::io(&path))?;
    let damaged = |error: serde_json::Error| DatasetError::file(&path, error);
    let mut statistics: DataStatistics = serde_json::from_slice(&text).map_err(damaged)?;
    statistics.latent = Some(latent);
    let text = serde_json::to_vec_pretty(&statistics).map_err(damaged)?;
    // An atomic rename: the file is always complete.
    let partial = path.with_extension("partial");
    fs::write(&partial, text).map_err(DatasetError::io(&partial))?;
    fs::rename(&partial, &path).map_err(DatasetError::io(&path))
}
