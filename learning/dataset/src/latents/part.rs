use std::{
    fs::{self, File},
    io::ErrorKind,
    ops::Range,
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, ensure};

/// A file with the latents of consecutive frames, beside the future whole file.
pub(super) struct Part {
    path: PathBuf,
    file: File,
    frames: Range<usize>,
    frame_bytes: usize,
}

impl Part {
    /// Path of the part of `whole` with these frames.
    pub fn path_of(whole: &Path, frames: &Range<usize>) -> PathBuf {
        let mut path = whole.as_os_str().to_owned();
        path.push(format!(".frames-{}-{}", frames.start, frames.len()));
        path.into()
    }

    /// All parts of `whole`, which has `total` frames.
    ///
    /// # Errors
    /// If a part is unreadable, or its length differs from its name.
    pub fn find_all(whole: &Path, total: usize, frame_bytes: usize) -> Result<Vec<Self>> {
        let (Some(dir), Some(name)) = (whole.parent(), whole.file_name()) else {
            return Ok(Vec::new());
        };
        let entries = match fs::read_dir(dir) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.with_context(|| dir.display().to_string())?,
        };
        let mut parts = Vec::new();
        for entry in entries {
            let entry = entry.with_context(|| dir.display().to_string())?;
            let entry_name = entry.file_name();
            let Some(frames) = frames_of(&entry_name.to_string_lossy(), &name.to_string_lossy())
            else {
                continue;
            };
            let path = entry.path();
            let file = match File::open(&path) {
                // Another program has joined it.
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                file => file.with_context(|| path.display().to_string())?,
            };
            ensure!(
                frames.end <= total,
                "{}: expected at most {total} frames; remove the file to recompute it",
                path.display()
            );
            let found = file
                .metadata()
                .with_context(|| path.display().to_string())?;
            expect_length(&path, frames.len() * frame_bytes, found.len())?;
            parts.push(Self {
                path,
                file,
                frames,
                frame_bytes,
            });
        }
        Ok(parts)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether it has all these frames.
    pub fn has(&self, frames: &Range<usize>) -> bool {
        self.frames.start <= frames.start && frames.end <= self.frames.end
    }

    /// The latents of some of its frames.
    pub fn read(&self, frames: &Range<usize>) -> Result<Vec<u8>> {
        let mut latents = vec![0; frames.len() * self.frame_bytes];
        let at = frames.start.saturating_sub(self.frames.start) * self.frame_bytes;
        let read = self.file.read_exact_at(&mut latents, at as u64);
        read.with_context(|| self.path.display().to_string())?;
        Ok(latents)
    }

    /// Removes the joined part. A failure only wastes disk space.
    pub fn remove(&self) {
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!("cannot remove unneeded {}: {error}", self.path.display());
            }
            _ => (),
        }
    }
}

/// Rejects a file of another length.
pub(super) fn expect_length(path: &Path, expected: usize, found: u64) -> Result<()> {
    ensure!(
        found == expected as u64,
        "{}: expected {expected} bytes, found {found}; remove the file to recompute it",
        path.display()
    );
    Ok(())
}

/// The frames in a part's name; `None` if it is not a part of `whole`.
fn frames_of(name: &str, whole: &str) -> Option<Range<usize>> {
    let frames = name.strip_prefix(whole)?.strip_prefix(".frames-")?;
    let (first, count) = frames.split_once('-')?;
    let (first, count): (usize, usize) = (first.parse().ok()?, count.parse().ok()?);
    Some(first..first.checked_add(count)?)
}
