//! The files of a bag: plain, compressed by rosbag2, or with an sqlite3 journal.

use std::{
    fs::{self, File},
    io::{self, BufReader, Read as _, Write as _},
    path::{Path, PathBuf},
    sync::Arc,
};

use tempfile::TempDir;

use crate::{BagError, BagWarning};

/// First bytes of a zstd frame.
pub(crate) const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Folder of decompressed files if `TMPDIR` is not set: on a disk, unlike `/tmp` on many machines.
const TEMPORARY: &str = "/var/tmp";
/// Size of a decompression step \[bytes\].
const STEP_BYTES: usize = 1 << 20;

/// First bytes of an sqlite3 file.
pub(super) const SQLITE_MAGIC: &[u8] = b"SQLite format 3";
/// Endings of the journals that a killed writer leaves next to an sqlite3 file.
const JOURNALS: [&str; 2] = ["-wal", "-journal"];

/// A file of a bag, ready for reading.
#[derive(Clone, Debug)]
pub(crate) struct StoredFile {
    /// Path for messages to the user: of the compressed file, if it is one.
    pub path: PathBuf,
    copy: Option<Arc<Copy>>,
}

/// A temporary file that replaces a file of a bag. Dropping it deletes the file.
#[derive(Debug)]
struct Copy {
    file: File,
    /// Path and folder, if sqlite3 must open it by name.
    named: Option<(PathBuf, TempDir)>,
    has_journal: bool,
}

impl StoredFile {
    /// Opens a file; decompresses it if it is a zstd frame.
    ///
    /// # Errors
    /// The file cannot be read, or the folder for temporary files is full.
    pub fn open(path: &Path) -> Result<(Self, Option<BagWarning>), BagError> {
        let io = |source| BagError::io(path, source);
        let mut file = File::open(path).map_err(io)?;
        let mut front = Vec::new();
        (&mut file).take(16).read_to_end(&mut front).map_err(io)?;
        let (copy, warning) = if front.starts_with(&ZSTD_MAGIC) {
            decompress(path).map(|(copy, warning)| (Some(copy), Some(warning)))?
        } else if front.starts_with(SQLITE_MAGIC) && !journals(path).is_empty() {
            copy_with_journal(path).map(|(copy, warning)| (Some(copy), Some(warning)))?
        } else {
            (None, None)
        };
        let opened = Self {
            path: path.to_owned(),
            copy: copy.map(Arc::new),
        };
        Ok((opened, warning))
    }

    /// The file. Its position is shared, so use positioned reads.
    pub fn file(&self) -> io::Result<File> {
        match &self.copy {
            Some(copy) => copy.file.try_clone(),
            None => File::open(&self.path),
        }
    }

    /// Path of the temporary copy of an sqlite3 file.
    pub fn copy(&self) -> Option<&Path> {
        let copy = self.copy.as_ref()?.named.as_ref();
        copy.map(|(path, _)| path.as_path())
    }

    /// Whether the copy has a journal, which sqlite3 applies.
    pub fn has_journal(&self) -> bool {
        self.copy.as_ref().is_some_and(|copy| copy.has_journal)
    }
}

/// The folder of temporary files.
fn temporary_folder() -> PathBuf {
    match std::env::var_os("TMPDIR") {
        Some(folder) if !folder.is_empty() => PathBuf::from(folder),
        _ if Path::new(TEMPORARY).is_dir() => TEMPORARY.into(),
        _ => std::env::temp_dir(),
    }
}

fn no_room(path: &Path, folder: &Path, source: &io::Error) -> BagError {
    BagError::NoRoom {
        path: path.to_owned(),
        folder: folder.to_owned(),
        reason: source.to_string(),
    }
}

/// The journals next to an sqlite3 file.
fn journals(path: &Path) -> Vec<PathBuf> {
    let beside = |ending: &&str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    let all = JOURNALS.iter().map(beside);
    let is_filled = |path: &PathBuf| fs::metadata(path).is_ok_and(|found| found.len() > 0);
    all.filter(is_filled).collect()
}

/// Copies an sqlite3 file and its journal: sqlite3 applies the journal on opening, and the bag must not change.
fn copy_with_journal(path: &Path) -> Result<(Copy, BagWarning), BagError> {
    let folder = temporary_folder();
    let no_room = |source: io::Error| no_room(path, &folder, &source);
    let temporary = TempDir::new_in(&folder).map_err(no_room)?;
    // `StoredFile::open` has opened a file at this path.
    let name = path.file_name().unwrap_or_default();
    let named = temporary.path().join(name);
    let mut bytes = fs::copy(path, &named).map_err(no_room)?;
    for journal in journals(path) {
        // `journals` returns files only.
        let name = journal.file_name().unwrap_or_default();
        bytes += fs::copy(&journal, temporary.path().join(name)).map_err(no_room)?;
    }
    let copy = Copy {
        file: File::open(&named).map_err(no_room)?,
        named: Some((named, temporary)),
        has_journal: true,
    };
    let file = path.to_owned();
    let warning = BagWarning::Journal {
        file,
        folder: folder.clone(),
        bytes,
    };
    Ok((copy, warning))
}

/// Decompresses a file. If it is damaged or ends early, the part before that is kept.
fn decompress(path: &Path) -> Result<(Copy, BagWarning), BagError> {
    let io = |source| BagError::io(path, source);
    let folder = temporary_folder();
    let no_room = |source: io::Error| no_room(path, &folder, &source);
    let temporary = TempDir::new_in(&folder).map_err(no_room)?;
    let named = temporary.path().join("decompressed");
    let mut output = File::create_new(&named).map_err(no_room)?;
    let input = BufReader::new(File::open(path).map_err(io)?);
    let mut decoder = zstd::stream::read::Decoder::with_buffer(input).map_err(io)?;
    let mut step = vec![0; STEP_BYTES];
    let (mut bytes, mut is_sqlite) = (0, false);
    let problem = loop {
        match decoder.read(&mut step) {
            Ok(0) => break None,
            Ok(read) => {
                // `Read` never returns more than the buffer's size.
                let read = step.get(..read).unwrap_or_default();
                is_sqlite |= bytes == 0 && read.starts_with(SQLITE_MAGIC);
                output.write_all(read).map_err(no_room)?;
                bytes += read.len() as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => break Some(error.to_string()),
        }
    };
    let file = path.to_owned();
    let warning = match problem {
        None => BagWarning::Decompressed {
            file,
            folder: folder.clone(),
            bytes,
        },
        Some(reason) => BagWarning::CompressedEnd {
            file,
            bytes,
            reason,
        },
    };
    let copy = Copy {
        file: File::open(&named).map_err(no_room)?,
        // Without a name, the file is deleted when this process ends, in any way; sqlite3 needs a name.
        named: is_sqlite.then_some((named, temporary)),
        has_journal: false,
    };
    Ok((copy, warning))
}

/// The files of a recorder in a folder, in numeric order (`bag_2` before `bag_10`), and warnings about skipped ones.
///
/// A recorder with file compression that is killed leaves its open file uncompressed. If it is killed while it compresses,
/// it leaves a file in both forms, of which the compressed one may be incomplete.
///
/// # Errors
/// The folder has no such file, or cannot be read.
pub(crate) fn numbered_files(dir: &Path) -> Result<(Vec<PathBuf>, Vec<BagWarning>), BagError> {
    let mut files = Vec::new();
    let mut warnings = Vec::new();
    let io = |source| BagError::io(dir, source);
    for entry in fs::read_dir(dir).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if let Some((stem, rank)) = storage_stem(&path) {
            let digits = stem.rsplit('_').next();
            let number = digits.and_then(|digits| digits.parse::<u64>().ok());
            files.push((number, stem, rank, path));
        }
    }
    files.sort();
    let mut kept: Vec<(String, PathBuf)> = Vec::new();
    for (_, stem, _, path) in files {
        // Plain files are preferred, and MCAP to sqlite3.
        if kept.last().is_some_and(|(last, _)| *last == stem) {
            warnings.push(BagWarning::Twice { file: path });
        } else {
            kept.push((stem, path));
        }
    }
    if kept.is_empty() {
        return Err(BagError::Empty {
            path: dir.to_owned(),
            reason: "it has no metadata.yaml, and no .mcap, .mcap.zstd or .db3 file",
        });
    }
    Ok((kept.into_iter().map(|(_, path)| path).collect(), warnings))
}

/// Whether this is the name of a bag's file: MCAP or sqlite3, compressed by rosbag2 or not.
#[must_use]
pub fn is_bag_file(path: &Path) -> bool {
    storage_stem(path).is_some()
}

/// Another form of this file in the same folder that is read instead. A recorder that is killed while it compresses
/// leaves both.
#[must_use]
pub fn preferred_form(path: &Path) -> Option<PathBuf> {
    let (stem, rank) = storage_stem(path)?;
    let names = ENDINGS.iter().take(rank);
    let mut paths = names.map(|ending| path.with_file_name(format!("{stem}{ending}")));
    paths.find(|path| path.is_file())
}

/// Endings of a bag's files, in order of preference.
const ENDINGS: [&str; 6] = [
    ".mcap",
    ".mcap.zstd",
    ".mcap.zst",
    ".db3",
    ".db3.zstd",
    ".db3.zst",
];

/// Name of a bag's file without ending, and the index of its ending; `None` for other files.
fn storage_stem(path: &Path) -> Option<(String, usize)> {
    let name = path.file_name()?.to_string_lossy();
    ENDINGS.iter().enumerate().find_map(|(rank, ending)| {
        let stem = name.strip_suffix(ending)?;
        Some((stem.to_owned(), rank))
    })
}

/// A file that `metadata.yaml` lists, searched by its name in the folder, since bags are moved (as rosbag2 does), or by
/// that name after compression or decompression.
pub(crate) fn listed_file(dir: &Path, listed: &Path) -> Option<PathBuf> {
    let name = listed.file_name()?.to_string_lossy().into_owned();
    let plain = name
        .strip_suffix(".zstd")
        .or_else(|| name.strip_suffix(".zst"));
    let plain = plain.unwrap_or(&name);
    let names = [
        name.clone(),
        plain.to_owned(),
        format!("{plain}.zstd"),
        format!("{plain}.zst"),
    ];
    names
        .iter()
        .map(|name| dir.join(name))
        .find(|path| path.exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_a_bag_are_recognised_by_name() {
        for name in [
            "a.mcap",
            "a/b_0.mcap.zstd",
            "b.mcap.zst",
            "c.db3",
            "c.db3.zstd",
        ] {
            assert!(is_bag_file(Path::new(name)), "{name}");
        }
        for name in ["a.zstd", "metadata.yaml", "mcap", "a.db3-wal", "a.mcap.tmp"] {
            assert!(!is_bag_file(Path::new(name)), "{name}");
        }
    }
}
