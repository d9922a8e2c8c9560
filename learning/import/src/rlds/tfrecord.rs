use std::{
    fs::File,
    os::unix::fs::FileExt as _,
    path::{Path, PathBuf},
    rc::Rc,
};

use crate::ImportError;

/// Limit of a record; episodes are far smaller.
const MAX_RECORD_BYTES: u64 = 1 << 30;

/// Sizes of a length with its CRC, and of a CRC \[bytes\].
const HEADER: u64 = 12;
const CRC: u64 = 4;

/// Iterates over the records of a TFRecord file by their lengths, without reading data. A record is: length (8 bytes,
/// little endian), masked CRC-32C of the length, data, masked CRC-32C of the data.
pub(super) struct TfRecords {
    stream: Rc<Stream>,
    /// Start of the next record.
    at: u64,
    end: u64,
}

pub(super) struct Record {
    stream: Rc<Stream>,
    start: u64,
    length: u64,
}

struct Stream {
    path: PathBuf,
    file: File,
}

impl TfRecords {
    pub fn open(path: &Path) -> Result<Self, ImportError> {
        let io = |source| ImportError::io(path, source);
        let file = File::open(path).map_err(io)?;
        let end = file.metadata().map_err(io)?.len();
        let path = path.to_owned();
        Ok(Self {
            stream: Rc::new(Stream { path, file }),
            at: 0,
            end,
        })
    }

    fn locate(&self) -> Result<Record, ImportError> {
        let (start, stream) = (self.at, &self.stream);
        let left = self.end.saturating_sub(start);
        let Some(left) = left.checked_sub(HEADER) else {
            return Err(ImportError::corrupt(
                &stream.path,
                format!("it ends within a record, at byte {start}"),
            ));
        };
        let length_bytes: [u8; 8] = stream.array(start)?;
        let length_crc = u32::from_le_bytes(stream.array(start + 8)?);
        if masked_crc(&length_bytes) != length_crc {
            return Err(stream.damaged(start, "wrong CRC of its length; is this a TFRecord file?"));
        }
        let length = u64::from_le_bytes(length_bytes);
        if length > MAX_RECORD_BYTES {
            let reason = format!("{length} bytes, more than the limit of {MAX_RECORD_BYTES}");
            return Err(stream.damaged(start, &reason));
        }
        if length.saturating_add(CRC) > left {
            let reason = format!("it has {length} bytes, but only {left} are left in the file");
            return Err(stream.damaged(start, &reason));
        }
        Ok(Record {
            stream: self.stream.clone(),
            start,
            length,
        })
    }
}

impl Iterator for TfRecords {
    type Item = Result<Record, ImportError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.at >= self.end {
            return None;
        }
        let record = self.locate();
        // Records after a damaged length cannot be found.
        self.at = record.as_ref().map_or(self.end, Record::end);
        Some(record)
    }
}

impl Record {
    /// Reads the data and checks its CRC.
    pub fn read(&self) -> Result<Vec<u8>, ImportError> {
        let stream = &self.stream;
        // Fits: at most MAX_RECORD_BYTES.
        let mut data = vec![0; self.length as usize];
        stream.fill(&mut data, self.start + HEADER)?;
        let crc = u32::from_le_bytes(stream.array(self.start + HEADER + self.length)?);
        if masked_crc(&data) != crc {
            return Err(stream.damaged(self.start, "wrong CRC of its data"));
        }
        Ok(data)
    }

    fn end(&self) -> u64 {
        self.start + HEADER + self.length + CRC
    }
}

impl Stream {
    fn array<const N: usize>(&self, at: u64) -> Result<[u8; N], ImportError> {
        let mut bytes = [0; N];
        self.fill(&mut bytes, at)?;
        Ok(bytes)
    }

    fn fill(&self, bytes: &mut [u8], at: u64) -> Result<(), ImportError> {
        self.file
            .read_exact_at(bytes, at)
            .map_err(|source| ImportError::io(&self.path, source))
    }

    fn damaged(&self, start: u64, reason: &str) -> ImportError {
        ImportError::corrupt(&self.path, format!("the record at byte {start}: {reason}"))
    }
}

/// Masked CRC-32C of TFRecord (tensorflow/core/lib/hash/crc32c.h).
pub(super) fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(0xa282_ead8)
}
