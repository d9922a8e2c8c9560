//! Where the tensors of a torch file lie.
//!
//! The file is a zip archive: `NAME/data.pkl` is a pickle of the saved object, in which a tensor is a call of
//! `torch._utils._rebuild_tensor_v2` with the number of a storage, and `NAME/data/NUMBER` are the values of that
//! storage, uncompressed. (torch/serialization.py, `_save`.) A TorchScript file is the same with modules in the pickle,
//! and with code, which is not looked at. (torch/csrc/jit/serialization/pickler.cpp.)
//!
//! The pickle is checked against the archive's CRC-32 here, a storage when the first of its tensors is read: opening a
//! file of gigabytes reads none of its values.

use std::collections::{BTreeMap, HashMap};
use std::io::{Cursor, Read as _};
use std::sync::Arc;

use zip::{CompressionMethod, ZipArchive};

use super::entry::Entry;
use super::pickle;
use super::state_dict::{self, Stored};
use super::storage::Storage;

/// A pickle larger than this describes no checkpoint: it has about a hundred bytes for each tensor.
const MAX_PICKLE: u64 = 64 << 20;

/// All tensors of the file, by the path of keys to them.
pub(super) fn index(bytes: &[u8]) -> Result<BTreeMap<String, Entry>, String> {
    let describe = |error: zip::result::ZipError| format!("a damaged torch file: {error}");
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(describe)?;
    let mut members = Vec::new();
    let mut pickled = None;
    for i in 0..archive.len() {
        let file = archive.by_index_raw(i).map_err(describe)?;
        let name = file.name().map_err(describe)?.into_owned();
        if let Some(root) = name.strip_suffix("data.pkl")
            && root.matches('/').count() <= 1
        {
            pickled = Some((i, root.to_owned(), file.size()));
        }
        if file.compression() == CompressionMethod::Stored
            && let Some(start) = file.data_start()
        {
            let range = region(start, file.size(), bytes.len())?;
            members.push((name, range, file.crc32()));
        }
    }
    let Some((i, root, size)) = pickled else {
        return Err("a zip archive without data.pkl: not a torch file".to_owned());
    };
    if size > MAX_PICKLE {
        return Err(format!(
            "data.pkl has {size} bytes, expected at most {MAX_PICKLE}"
        ));
    }
    // `torch.save` writes zero everywhere if told not to compute checksums.
    let has_checksums = members.iter().any(|(_, _, crc32)| *crc32 != 0);
    let storages: HashMap<String, Arc<Storage>> = members
        .into_iter()
        .map(|(name, range, crc32)| {
            let crc32 = has_checksums.then_some(crc32);
            (name.clone(), Arc::new(Storage::new(name, range, crc32)))
        })
        .collect();
    if let Some(order) = storages.get(&format!("{root}byteorder"))
        && order.bytes(bytes) != b"little"
    {
        return Err("written on a big-endian machine, which is not supported".to_owned());
    }
    let mut inflated = Vec::new();
    let pickle_bytes = match storages.get(&format!("{root}data.pkl")) {
        Some(stored) => {
            stored.verify_slice(bytes)?;
            stored.bytes(bytes)
        }
        None => {
            let file = archive.by_index(i).map_err(describe)?;
            // The size that the archive states need not be true of compressed data.
            file.take(MAX_PICKLE)
                .read_to_end(&mut inflated)
                .map_err(|error| format!("data.pkl: {error}"))?;
            &inflated
        }
    };
    let pickle = pickle::Pickle::parse(pickle_bytes).map_err(|e| format!("data.pkl: {e}"))?;
    let stored = state_dict::tensors(&pickle).map_err(|e| format!("data.pkl: {e}"))?;
    let mut entries = BTreeMap::new();
    for (name, tensor) in stored {
        let entry = place(tensor, &root, &storages)
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
    storages: &HashMap<String, Arc<Storage>>,
) -> Result<Entry, String> {
    let name = format!("{root}data/{}", tensor.storage);
    let Some(storage) = storages.get(&name) else {
        return Err(format!(
            "its storage {name} is not in the archive, or is compressed there"
        ));
    };
    let (start, end) = storage.range();
    let first = tensor
        .offset
        .checked_mul(tensor.element.size())
        .and_then(|offset| start.checked_add(offset))
        .ok_or("its offset overflows")?;
    let entry = Entry::checked(
        tensor.element,
        tensor.shape,
        Some(tensor.strides),
        first,
        end,
    )?;
    Ok(Entry {
        storage: Some(Arc::clone(storage)),
        ..entry
    })
}
