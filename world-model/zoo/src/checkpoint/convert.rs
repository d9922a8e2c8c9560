//! Writing a checkpoint as safetensors.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use serde_json::{Map, Value, json};

use super::bytes::Bytes;
use super::entry::Entry;
use super::{Checkpoint, values};
use crate::{Error, Result};

/// Bytes that are written before the pages they came from are given back.
const CHUNK: usize = 16 << 20;

/// Tensors may share their values, as tied weights and an average that has not started do; written, each has its own.
/// What grows by more than this is made to fill a disk.
const MOST_SHARED: usize = 8;

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conversion {
    /// Number of tensors.
    pub tensors: usize,
    /// Number of values in those of floating-point numbers.
    pub parameters: usize,
    /// Size of the file.
    pub bytes: u64,
}

/// Writes all tensors of `checkpoint` to `path`, in the number formats that they have. The file appears there when it
/// is complete. Takes little memory, however large the checkpoint is.
///
/// # Errors
/// If the file cannot be written, would be many times as large as the checkpoint, or a tensor's bytes in a torch file are
/// not those of the archive's CRC-32.
pub fn convert(checkpoint: &Checkpoint, path: impl AsRef<Path>) -> Result<Conversion> {
    let path = path.as_ref();
    check_size(checkpoint)?;
    for entry in checkpoint.entries.values() {
        checkpoint.verify(entry)?;
    }
    let partial = path.with_extension("partial");
    let written = write(checkpoint, &partial).and_then(|conversion| {
        fs::rename(&partial, path)?;
        Ok(conversion)
    });
    written.map_err(|error| {
        // What is left of it is of no use to anybody; the error of interest is the first one.
        fs::remove_file(&partial).ok();
        Error::io(path, error)
    })
}

/// Checks that the tensors are not many times what the checkpoint holds.
fn check_size(checkpoint: &Checkpoint) -> Result<()> {
    let entries = checkpoint.entries.values();
    let bytes = entries.fold(0usize, |bytes, entry| {
        bytes.saturating_add(entry.count().saturating_mul(entry.element.size()))
    });
    let file = checkpoint.bytes.as_slice().len();
    if bytes <= file.saturating_mul(MOST_SHARED) {
        return Ok(());
    }
    Err(Error::Corrupt {
        file: checkpoint.file().to_owned(),
        reason: format!(
            "its tensors have {bytes} bytes in a file of {file}: they share the same values"
        ),
    })
}

fn write(checkpoint: &Checkpoint, path: &Path) -> std::io::Result<Conversion> {
    let mut entries: Vec<(&String, &Entry)> = checkpoint.entries.iter().collect();
    // Wide formats first, so that every tensor is aligned to its format, as the safetensors library writes them.
    entries.sort_by_key(|(name, entry)| (std::cmp::Reverse(entry.element.size()), *name));
    let mut header = Map::new();
    header.insert("__metadata__".to_owned(), json!({"format": "pt"}));
    let mut offset = 0;
    for (name, entry) in &entries {
        let end = offset + entry.count() * entry.element.size();
        let tensor = json!({
            "dtype": entry.element.name(),
            "shape": entry.shape,
            "data_offsets": [offset, end],
        });
        header.insert((*name).clone(), tensor);
        offset = end;
    }
    let mut header = Value::Object(header).to_string().into_bytes();
    // The format pads the header with spaces so that the data are aligned.
    header.resize(header.len().next_multiple_of(8), b' ');

    let mut file = BufWriter::new(File::create(path)?);
    file.write_all(&(header.len() as u64).to_le_bytes())?;
    file.write_all(&header)?;
    for (_, entry) in &entries {
        copy(&checkpoint.bytes, entry, &mut file)?;
    }
    let file = file.into_inner().map_err(|error| error.into_error())?;
    file.sync_all()?;
    Ok(Conversion {
        tensors: entries.len(),
        parameters: checkpoint.parameters(),
        bytes: (size_of::<u64>() + header.len() + offset) as u64,
    })
}

/// Writes the values of `entry`, rows in order, as they are.
fn copy(bytes: &Bytes, entry: &Entry, file: &mut impl Write) -> std::io::Result<()> {
    let all = values::stored(bytes, entry);
    match &entry.strides {
        None => {
            for (i, chunk) in all.chunks(CHUNK).enumerate() {
                file.write_all(chunk)?;
                bytes.release(entry.start + i * CHUNK, chunk.len());
            }
        }
        Some(strides) => {
            let size = entry.element.size();
            for at in values::offsets(&entry.shape, strides) {
                let stored = all.get(at * size..(at + 1) * size);
                file.write_all(stored.ok_or(std::io::ErrorKind::UnexpectedEof)?)?;
            }
            bytes.release(entry.start, all.len());
        }
    }
    Ok(())
}
