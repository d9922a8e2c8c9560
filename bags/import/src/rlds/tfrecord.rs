use std::{
    fs::File,
    io::{BufReader, Read},
    path::{Path, PathBuf},
};

use crate::ImportError;

/// No episode comes near this; a longer record is not one.
const MAX_RECORD_BYTES: u64 = 1 << 30;

/// The records of a TFRecord file, held against their CRCs. Each is: length (8 bytes, little endian), masked CRC-32C of
/// the length, data, masked CRC-32C of the data.
pub(super) struct TfRecords {
    file: PathBuf,
    stream: BufReader<File>,
    left: u64,
    at: u64,
}

impl TfRecords {
    pub fn open(file: &Path) -> Result<Self, ImportError> {
        let io = |source| ImportError::io(file, source);
        let stream = File::open(file).map_err(io)?;
        let left = stream.metadata().map_err(io)?.len();
        Ok(Self {
            file: file.to_owned(),
            stream: BufReader::new(stream),
            left,
            at: 0,
        })
    }

    fn record(&mut self) -> Result<Vec<u8>, ImportError> {
        let start = self.at;
        let damaged = |file: &Path, reason: &str| {
            ImportError::corrupt(file, format!("the record at byte {start}: {reason}"))
        };
        let length_bytes: [u8; 8] = self.take()?;
        let length_crc = u32::from_le_bytes(self.take()?);
        if masked_crc(&length_bytes) != length_crc {
            return Err(damaged(
                &self.file,
                "wrong CRC of its length; is this a TFRecord file?",
            ));
        }
        let length = u64::from_le_bytes(length_bytes);
        if length > MAX_RECORD_BYTES {
            return Err(damaged(
                &self.file,
                &format!("{length} bytes, more than the limit of {MAX_RECORD_BYTES}"),
            ));
        }
        if length.saturating_add(4) > self.left {
            return Err(damaged(
                &self.file,
                &format!(
                    "it has {length} bytes, but only {} are left in the file",
                    self.left
                ),
            ));
        }
        // At most MAX_RECORD_BYTES, which fits.
        let mut data = vec![0; length as usize];
        self.fill(&mut data)?;
        let crc = u32::from_le_bytes(self.take()?);
        if masked_crc(&data) != crc {
            return Err(damaged(&self.file, "wrong CRC of its data"));
        }
        Ok(data)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], ImportError> {
        if (N as u64) > self.left {
            return Err(ImportError::corrupt(
                &self.file,
                format!("it ends within a record, at byte {}", self.at),
            ));
        }
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), ImportError> {
        self.stream
            .read_exact(bytes)
            .map_err(|source| ImportError::io(&self.file, source))?;
        let length = bytes.len() as u64;
        self.left = self.left.saturating_sub(length);
        self.at += length;
        Ok(())
    }
}

impl Iterator for TfRecords {
    type Item = Result<Vec<u8>, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.left == 0 {
            return None;
        }
        let record = self.record();
        if record.is_err() {
            // Nothing after a damaged record can be found.
            self.left = 0;
        }
        Some(record)
    }
}

/// CRC-32C as TFRecord stores it (tensorflow/core/lib/hash/crc32c.h).
pub(super) fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}
