//! An unfinished download.

use anyhow::{Context as _, Result};
use sha2::Sha256;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use ureq::http::{HeaderMap, header::ETAG};

/// Longer entity tags are ignored: servers send about 70 bytes.
const MAX_ETAG_BYTES: u64 = 1024;

/// The received bytes, in `FILE.part`, and the entity tag of their file in `FILE.part.etag`, if the server sent one.
/// Bytes without a tag may be of any version, so they are not resumed.
pub(super) struct Part {
    path: PathBuf,
    etag: PathBuf,
}

/// The state from which a download resumes.
#[derive(Default)]
pub(super) struct Start {
    /// Hash of the received bytes.
    pub hash: Sha256,
    /// How many bytes.
    pub have: u64,
    /// The entity tag of their file; not empty if there are bytes.
    pub etag: String,
}

impl Part {
    pub(super) fn of(path: &Path) -> Self {
        let with = |ending: &str| {
            let mut name = path.as_os_str().to_owned();
            name.push(ending);
            PathBuf::from(name)
        };
        Self {
            path: with(".part"),
            etag: with(".part.etag"),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The resumable bytes.
    pub(super) fn start(&self) -> Result<Start> {
        let Some(etag) = self.read_etag()?.filter(|etag| is_strong(etag)) else {
            return Ok(Start::default());
        };
        if !self.path.exists() {
            return Ok(Start::default());
        }
        let (hash, have) = super::hash_file(&self.path)?;
        Ok(Start { hash, have, etag })
    }

    fn read_etag(&self) -> Result<Option<String>> {
        let file = match File::open(&self.etag) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error).with_context(|| self.etag.display().to_string()),
        };
        let mut etag = Vec::new();
        file.take(MAX_ETAG_BYTES)
            .read_to_end(&mut etag)
            .with_context(|| self.etag.display().to_string())?;
        Ok(String::from_utf8(etag).ok())
    }

    /// Restarts with a file of this entity tag.
    pub(super) fn begin(&self, etag: Option<&str>) -> Result<File> {
        let context = || self.path.display().to_string();
        let mut options = OpenOptions::new();
        options.create(true).write(true).truncate(true);
        let file = options.open(&self.path).with_context(context)?;
        // the old bytes must be gone before the new tag is written
        file.sync_all().with_context(context)?;
        match etag {
            Some(etag) => File::create(&self.etag)
                .and_then(|mut file| file.write_all(etag.as_bytes()))
                .with_context(|| self.etag.display().to_string())?,
            None => remove(&self.etag)?,
        }
        Ok(file)
    }

    /// Opens the bytes for appending.
    pub(super) fn resume(&self) -> Result<File> {
        let file = OpenOptions::new().append(true).open(&self.path);
        file.with_context(|| self.path.display().to_string())
    }

    pub(super) fn discard(&self) -> Result<()> {
        remove(&self.path)?;
        remove(&self.etag)
    }

    /// Renames the complete part to `path`.
    pub(super) fn finish(&self, path: &Path) -> Result<()> {
        fs::rename(&self.path, path).with_context(|| path.display().to_string())?;
        remove(&self.etag)
    }
}

/// The entity tag for later range requests.
pub(super) fn strong_etag(headers: &HeaderMap) -> Option<&str> {
    let etag = headers.get(ETAG)?.to_str().ok()?;
    is_strong(etag).then_some(etag)
}

/// A weak tag (`W/"..."`) does not promise the same bytes: RFC 9110, section 13.1.5.
fn is_strong(etag: &str) -> bool {
    let is_visible = etag.bytes().all(|byte| byte.is_ascii_graphic());
    let is_quoted = etag.len() > 2 && etag.starts_with('"') && etag.ends_with('"');
    is_quoted && is_visible && etag.len() as u64 <= MAX_ETAG_BYTES
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}
