//! The values of one or several tensors in a torch file, and the checksum that the archive states of them.

use std::sync::OnceLock;

use super::bytes::Bytes;

/// Bytes that are summed before their pages are given back.
const CHUNK: usize = 16 << 20;

/// An uncompressed member of the archive. Its checksum is computed once, before the first of its tensors is read.
#[derive(Debug)]
pub(super) struct Storage {
    name: String,
    /// First byte in the file, and the one behind the last.
    range: (usize, usize),
    /// `None` where the file was written without checksums (`torch.serialization.set_crc32_options(False)`).
    crc32: Option<u32>,
    found: OnceLock<u32>,
}

impl Storage {
    pub(super) fn new(name: String, range: (usize, usize), crc32: Option<u32>) -> Self {
        Self {
            name,
            range,
            crc32,
            found: OnceLock::new(),
        }
    }

    /// The checksum that the archive states.
    pub(super) fn crc32(&self) -> Option<u32> {
        self.crc32
    }

    /// Where its bytes lie in the file.
    pub(super) fn range(&self) -> (usize, usize) {
        self.range
    }

    /// Its bytes, in the file's; none if the range is not within the file, which an index has checked.
    pub(super) fn bytes<'a>(&self, file: &'a [u8]) -> &'a [u8] {
        let (start, end) = self.range;
        file.get(start..end).unwrap_or_default()
    }

    /// Checks that the bytes are those that were written.
    ///
    /// # Errors
    /// Says what the checksum is and what it should be.
    pub(super) fn verify(&self, file: &Bytes) -> Result<(), String> {
        let Some(expected) = self.crc32 else {
            return Ok(());
        };
        let found = *self.found.get_or_init(|| {
            let mut hasher = crc32fast::Hasher::new();
            for (i, chunk) in self.bytes(file.as_slice()).chunks(CHUNK).enumerate() {
                hasher.update(chunk);
                file.release(self.range.0 + i * CHUNK, chunk.len());
            }
            hasher.finalize()
        });
        self.compare(found, expected)
    }

    /// As [`Storage::verify`], of a file that is in memory.
    pub(super) fn verify_slice(&self, file: &[u8]) -> Result<(), String> {
        match self.crc32 {
            Some(expected) => self.compare(crc32fast::hash(self.bytes(file)), expected),
            None => Ok(()),
        }
    }

    fn compare(&self, found: u32, expected: u32) -> Result<(), String> {
        if found == expected {
            return Ok(());
        }
        Err(format!(
            "{} is damaged: its CRC-32 is {found:08x}, expected {expected:08x}",
            self.name
        ))
    }
}
