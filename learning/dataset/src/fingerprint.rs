use std::{
    fs::{self, File},
    path::Path,
};

use sha2::{Digest as _, Sha256};

use super::DatasetError;

/// SHA-256 of a bag's files in hex, independent of its location and name.
pub(super) fn fingerprint(bag: &Path) -> Result<String, DatasetError> {
    let mut hash = Sha256::new();
    let mut files = Vec::new();
    if bag.is_dir() {
        for entry in fs::read_dir(bag).map_err(DatasetError::io(bag))? {
            files.push(entry.map_err(DatasetError::io(bag))?.path());
        }
        files.sort();
    } else {
        files.push(bag.to_owned());
    }
    for path in files.iter().filter(|path| path.is_file()) {
        let mut contents = Sha256::new();
        let mut file = File::open(path).map_err(DatasetError::io(path))?;
        std::io::copy(&mut file, &mut contents).map_err(DatasetError::io(path))?;
        hash.update(contents.finalize());
    }
    Ok(hex(hash))
}

/// The digest in hex.
pub(super) fn hex(hash: Sha256) -> String {
    let bytes = hash.finalize();
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The part of a digest used in file names.
pub(crate) fn short(digest: &str) -> String {
    digest.chars().take(16).collect()
}
