//! Where the tensors of a torch file lie.
//!
//! The file is a zip archive: `NAME/data.pkl` is a pickle of the saved object, in which a tensor is a call of
//! `torch._utils._rebuild_tensor_v2` with the number of a storage, and `NAME/data/NUMBER` are the values of that
//! storage, uncompressed. (torch/serialization.py, `_save`.) A TorchScript file is the same with modules in the pickle,
//! and with code, which is not looked at. (torch/csrc/jit/serialization/pickler.cpp.)

use std::collections::{BTreeMap, HashMap};
use std::io::{Cursor, Read as _};

use zip::{CompressionMethod, ZipArchive};

use super::entry::Entry;
use super::pickle;
use super::state_dict::{self, Stored};

/// A pickle larger than this describes no checkpoint: it has about a hundred bytes for each tensor.
const MAX_PICKLE: u64 = 64 << 20;

/// All tensors of the file, by the path of keys to them.
pub(super) fn index(bytes: &[u8]) -> Result<BTreeMap<String, Entry>, String> {
    let describe = |error: zip::result::ZipError| format!("a damaged torch file: {error}");
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(describe)?;
    let mut regions = HashMap::new();
    let mut pickled = None;
    for i in 0..archive.len() {
        let file = archive.by_index_raw(i).map_err(describe)?;
        let name = file.name().map_err(describe)?.into_owned();
        if let Some(root) = name.strip_suffix("data.pkl") {
            if root.matches('/').count() <= 1 {
                pickled = Some((i, root.to_owned(), file.size()));
            }
        } else if file.compression() == CompressionMethod::Stored
            && let Some(start) = file.data_start()
        {
            regions.insert(name, region(start, file.size(), bytes.len())?);
        }
    }
    let Some((i, root, size)) = pickled else {
        return Err("a zip archive without data.pkl: no torch file".to_owned());
    };
    if size > MAX_PICKLE {
        return Err(format!(
            "data.pkl has {size} bytes, expected at most {MAX_PICKLE}"
        ));
    }
    if let Some((start, end)) = regions.get(&format!("{root}byteorder"))
        && bytes.get(*start..*end) != Some(b"little")
    {
        return Err("written on a big-endian machine".to_owned());
    }
    let mut pickle_bytes = Vec::new();
    let file = archive.by_index(i).map_err(describe)?;
    // The size that the archive states need not be true of compressed data.
    file.take(MAX_PICKLE)
        .read_to_end(&mut pickle_bytes)
        .map_err(|error| format!("data.pkl: {error}"))?;
    let pickle = pickle::Pickle::parse(&pickle_bytes).map_err(|e| format!("data.pkl: {e}"))?;
    let stored = state_dict::tensors(&pickle).map_err(|e| format!("data.pkl: {e}"))?;
    let mut entries = BTreeMap::new();
    for (name, tensor) in stored {
        let entry = place(tensor, &root, &regions)
            .map_err(|reason| format!("tensor `{name}`: {reason}"))?;
        entries.insert(name, entry);
    }
    if entries.is_empty() {
        return Err("no tensors in it".to_owned());
    }
    Ok(entries)
}

/// Start and end of an archived file's bytes.
fn region(start: u64, size: u64, len: usize) -> Result<(usize, usize), String> {
    let as_usize = |value: Option<u64>| value.and_then(|value| usize::try_from(value).ok());
    match (as_usize(Some(start)), as_usize(start.checked_add(size))) {
        (Some(start), Some(end)) if end <= len => Ok((start, end)),
        _ => Err(format!("{size} bytes at {start} in a file of {len}")),
    }
}

/// Finds the values of a tensor.
fn place(
    tensor: Stored<'_>,
    root: &str,
    regions: &HashMap<String, (usize, usize)>,
) -> Result<Entry, String> {
    let name = format!("{root}data/{}", tensor.storage);
    let Some((start, end)) = regions.get(&name) else {
        return Err(format!(
            "its storage {name} is not in the archive, or is compressed there"
        ));
    };
    let first = tensor
        .offset
        .checked_mul(tensor.element.size())
        .and_then(|offset| start.checked_add(offset))
        .ok_or("its offset overflows")?;
    Entry::checked(
        tensor.element,
        tensor.shape,
        Some(tensor.strides),
        first,
        *end,
    )
}
