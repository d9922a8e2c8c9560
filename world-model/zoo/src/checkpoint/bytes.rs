//! The bytes of a file, mapped or owned.

use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

use memmap2::Mmap;
#[cfg(unix)]
use memmap2::UncheckedAdvice;

use crate::packed_cache::Stamp;
use crate::{Error, Result};

/// A file's bytes.
#[derive(Debug)]
pub(super) enum Bytes {
    /// Of a file, and which state of it.
    Mapped(Mmap, Option<Stamp>),
    Owned(Vec<u8>),
}

impl Bytes {
    pub(super) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        // What the system says of a folder that is mapped does not help anybody.
        let metadata = file.metadata().map_err(|e| Error::io(path, e))?;
        if metadata.is_dir() {
            return Err(Error::io(path, ErrorKind::IsADirectory.into()));
        }
        // SAFETY: the map is only read. Checkpoints are replaced by renaming a new file over the old one (as the
        // writers of this project and the usual download tools do), not rewritten in place while they are in use.
        let map = unsafe { Mmap::map(&file) }.map_err(|e| Error::io(path, e))?;
        Ok(Self::Mapped(map, Stamp::new(path, &metadata)))
    }

    pub(super) fn as_slice(&self) -> &[u8] {
        match self {
            Self::Mapped(map, _) => map,
            Self::Owned(bytes) => bytes,
        }
    }

    /// Which state of which file they are, if they are one's.
    pub(super) fn stamp(&self) -> Option<&Stamp> {
        match self {
            Self::Mapped(_, stamp) => stamp.as_ref(),
            Self::Owned(_) => None,
        }
    }

    /// Tells the system that the bytes from `start` on were read for the last time for now, so that their pages no
    /// longer count as this process's memory. They can be read again all the same.
    pub(super) fn release(&self, start: usize, len: usize) {
        #[cfg(unix)]
        if let Self::Mapped(map, _) = self
            && start.checked_add(len).is_some_and(|end| end <= map.len())
        {
            // SAFETY: the map is a read-only one of a file, never written to; pages that are dropped are read from
            // the file again when they are next touched, with the same content.
            let advised =
                unsafe { map.unchecked_advise_range(UncheckedAdvice::DontNeed, start, len) };
            // It is advice: a system that does not take it only keeps the pages for longer.
            advised.ok();
        }
        #[cfg(not(unix))]
        let _ = (start, len);
    }
}
