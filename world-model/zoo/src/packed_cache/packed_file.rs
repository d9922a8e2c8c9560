//! Reading and writing a file of packed weights.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use memmap2::Mmap;
use rayon::prelude::*;
use wm_model::NumberFormat;
use wm_model::ops::{MappedBytes, PackedLinear, packed_layout};

use super::header::{Header, Matrix, Refusal};
use super::identity::Identity;

/// A file that was checked as a whole.
#[derive(Debug)]
pub(super) struct PackedFile {
    header: Header,
    map: Arc<Mmap>,
}

impl PackedFile {
    /// Opens the file at `path`, which has to be of this checkpoint and of the order of packing of this process; `None` if
    /// there is none.
    pub(super) fn open(path: &Path, identity: &Identity) -> Result<Option<Self>, Refusal> {
        // Before it is opened, which would wait for the other end of a pipe.
        match std::fs::metadata(path) {
            Ok(metadata) if metadata.is_file() => {}
            Ok(_) => return Err(Refusal::Foreign),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error.into()),
        }
        let file = File::open(path)?;
        // SAFETY: the map is only read, and files of the cache are made read-only when they are complete and from then on
        // only renamed and deleted.
        let map = unsafe { Mmap::map(&file) }?;
        let header = Header::decode(&map)?;
        if header.identity != *identity {
            return Err(Refusal::Checkpoint);
        }
        let expected = packed_layout();
        if header.layout != expected {
            return Err(Refusal::Layout {
                expected,
                found: header.layout,
            });
        }
        let packed = Self {
            header,
            map: Arc::new(map),
        };
        packed.verify()?;
        // When it was last used: what is deleted first. That of others may not be mine to say.
        file.set_modified(SystemTime::now()).ok();
        Ok(Some(packed))
    }

    /// Checks every matrix against its checksum, on all threads, which also has the system read the file.
    fn verify(&self) -> Result<(), Refusal> {
        let matrices = self.header.matrices.par_iter();
        matrices
            .map(|matrix| {
                let bytes = self.bytes(matrix);
                let found = bytes.map(|bytes| crc32fast::hash(bytes.as_slice()));
                if found == Some(matrix.crc32) {
                    Ok(())
                } else {
                    Err(Refusal::Damaged(matrix.name.clone()))
                }
            })
            .collect()
    }

    fn bytes(&self, matrix: &Matrix) -> Option<MappedBytes> {
        let start = usize::try_from(matrix.start).ok()?;
        let end = start.checked_add(usize::try_from(matrix.bytes).ok()?)?;
        MappedBytes::new(&self.map, start..end)
    }

    /// The matrix `name` of this shape and format, with `bias`; `None` if it is not there.
    pub(super) fn linear(
        &self,
        name: &str,
        shape: (usize, usize),
        format: NumberFormat,
        bias: Option<&[f32]>,
    ) -> Option<PackedLinear> {
        let matrix = self.header.matrices.iter().find(|matrix| {
            let is_same = (matrix.outputs, matrix.inputs) == shape && matrix.format == format;
            is_same && matrix.name == name
        })?;
        PackedLinear::from_mapped(self.bytes(matrix)?, bias, shape, format).ok()
    }
}

/// Writes `matrices` with their names to `file`, which is empty.
pub(super) fn write(
    file: &File,
    (weights, identity): (String, Identity),
    matrices: &[(String, PackedLinear)],
) -> Result<(), Refusal> {
    let described = matrices.iter().map(|(name, packed)| {
        let mut crc32 = crc32fast::Hasher::new();
        for part in packed.packed_parts() {
            crc32.update(part);
        }
        Matrix {
            name: name.clone(),
            outputs: packed.outputs(),
            inputs: packed.inputs(),
            format: packed.format(),
            start: 0,
            bytes: packed.packed_length() as u64,
            crc32: crc32.finalize(),
        }
    });
    let mut header = Header {
        weights,
        identity,
        layout: packed_layout(),
        matrices: described.collect(),
        length: 0,
    };
    header.arrange()?;
    let mut writer = BufWriter::new(file);
    let mut written = 0;
    let mut put = |parts: &[&[u8]], start: u64| -> std::io::Result<()> {
        let gap = start.saturating_sub(written);
        std::io::copy(
            &mut std::io::Read::take(std::io::repeat(0), gap),
            &mut writer,
        )?;
        written += gap;
        for bytes in parts {
            written += bytes.len() as u64;
            writer.write_all(bytes)?;
        }
        Ok(())
    };
    put(&[&header.encode()?], 0)?;
    for (matrix, (_, packed)) in header.matrices.iter().zip(matrices) {
        put(&packed.packed_parts(), matrix.start)?;
    }
    Ok(writer.flush()?)
}
