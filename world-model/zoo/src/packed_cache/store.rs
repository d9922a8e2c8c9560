//! The folder: names, room, and putting a file into its place.

use std::fs::{self, File, OpenOptions};
use std::io::{Error, ErrorKind};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use super::PackedCache;

/// What complete files are called at the end.
const COMPLETE: &str = "packed";
/// What files that are being written are called at the end.
const PARTIAL: &str = "partial";
/// What was not written to for so long has no writer any more.
const ABANDONED: Duration = Duration::from_secs(600);

/// A file that is being written; it is deleted unless it is [put into its place](Partial::finish).
pub(super) struct Partial {
    pub(super) file: File,
    /// `None` once it is in its place: whatever is there then is somebody else's.
    path: Option<PathBuf>,
    place: PathBuf,
}

impl PackedCache {
    /// Place of the file `name`.
    pub(super) fn place(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{COMPLETE}"))
    }

    /// Starts a file of about `bytes` for `place`; `None` if another process, or thread, is at it.
    pub(super) fn start(&self, place: &Path, bytes: u64) -> Result<Option<Partial>, Error> {
        create_private(&self.folder)?;
        self.make_room(place, bytes)?;
        let path = place.with_extension(PARTIAL);
        if is_abandoned(&path) {
            fs::remove_file(&path)?;
        }
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => Ok(Some(Partial {
                file,
                path: Some(path),
                place: place.to_owned(),
            })),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Deletes what was not used for the longest time until `bytes` more are within the limit, without `place`, which is to
    /// be replaced.
    fn make_room(&self, place: &Path, bytes: u64) -> Result<(), Error> {
        let most = self.limits.most;
        if bytes > most {
            let reason = format!("{bytes} bytes, more than the limit of {most}");
            return Err(Error::new(ErrorKind::FileTooLarge, reason));
        }
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            let extension = path.extension().and_then(|e| e.to_str());
            if extension == Some(PARTIAL) && is_abandoned(&path) {
                fs::remove_file(&path).ok();
            }
            // What another process has deleted meanwhile takes no room.
            if extension == Some(COMPLETE)
                && path != place
                && let Ok(metadata) = fs::metadata(&path)
            {
                files.push((metadata.modified()?, metadata.len(), path));
            }
        }
        files.sort();
        let mut total = files
            .iter()
            .fold(bytes, |total, (_, len, _)| total.saturating_add(*len));
        for (_, length, path) in files {
            if total <= most {
                break;
            }
            fs::remove_file(&path)?;
            total -= length;
        }
        require_free(&self.folder, bytes)
    }
}

impl Partial {
    /// Makes the file read-only and puts it into its place.
    pub(super) fn finish(mut self) -> Result<(), Error> {
        let mut permissions = self.file.metadata()?.permissions();
        permissions.set_readonly(true);
        self.file.set_permissions(permissions)?;
        if let Some(path) = self.path.take()
            && let Err(error) = fs::rename(&path, &self.place)
        {
            self.path = Some(path);
            return Err(error);
        }
        Ok(())
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            // What cannot be deleted is abandoned, and deleted later.
            fs::remove_file(path).ok();
        }
    }
}

/// Whether there is a file at `path` that nobody has written to for long.
fn is_abandoned(path: &Path) -> bool {
    let modified = fs::metadata(path).and_then(|metadata| metadata.modified());
    // A file of the future, after the clock was set back, is new.
    let age = modified.map(|at| SystemTime::now().duration_since(at).unwrap_or_default());
    age.is_ok_and(|age| age > ABANDONED)
}

/// Creates a folder that others cannot read: weights may be somebody's own.
fn create_private(folder: &Path) -> Result<(), Error> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// Checks that `bytes` more leave as much free again: a disk that is full stops recordings.
#[cfg(unix)]
fn require_free(folder: &Path, bytes: u64) -> Result<(), Error> {
    let disk = rustix::fs::statvfs(folder)?;
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free / 2 >= bytes {
        return Ok(());
    }
    let reason = format!("{free} bytes are free, expected twice the {bytes} of it");
    Err(Error::new(ErrorKind::StorageFull, reason))
}

#[cfg(not(unix))]
fn require_free(_: &Path, _: u64) -> Result<(), Error> {
    Ok(())
}
