//! Records in the bytes of a chunk, or of a segment of a file without chunks.

use std::io::Read as _;

use bytes::Bytes;
use mcap::records::{ChunkHeader, Record, op};

use super::record::parse;

/// Limit of a record, and of a chunk before and after decompression. Chunks of rosbag2's largest preset have 4 MiB; one
/// with a very large message still fits.
pub(crate) const MAX_RECORD_BYTES: u64 = 256 << 20;
/// Size of the opcode and length before each record's body.
pub(crate) const RECORD_HEADER_BYTES: u64 = 9;

/// A record within a buffer.
pub(crate) struct RawRecord {
    pub opcode: u8,
    pub body: Bytes,
}

/// Iterates over the records of a buffer. Ends with one error if the buffer ends within a record.
pub(crate) struct Records {
    bytes: Bytes,
}

impl Records {
    pub fn new(bytes: Bytes) -> Self {
        Self { bytes }
    }
}

impl Iterator for Records {
    type Item = Result<RawRecord, String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.bytes.is_empty() {
            return None;
        }
        let Some((opcode, length)) = record_header(&self.bytes) else {
            self.bytes.clear();
            return Some(Err("it ends within a record".to_owned()));
        };
        let mut body = self.bytes.split_off(RECORD_HEADER_BYTES as usize);
        if length > body.len() as u64 {
            let available = body.len();
            self.bytes.clear();
            return Some(Err(format!(
                "a record claims {length} bytes where {available} are left"
            )));
        }
        // Fits: `length` is at most the buffer's size.
        self.bytes = body.split_off(length as usize);
        Some(Ok(RawRecord { opcode, body }))
    }
}

/// Opcode and body length \[bytes\] of the record at the front of `bytes`.
pub(crate) fn record_header(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&opcode, rest) = bytes.split_first()?;
    Some((opcode, u64::from_le_bytes(*rest.first_chunk::<8>()?)))
}

/// Decompresses a chunk record's body, and checks its length and CRC.
pub(crate) fn decompress(chunk_body: &[u8]) -> Result<Bytes, String> {
    let Record::Chunk { header, data } = parse(op::CHUNK, chunk_body)? else {
        return Err("it is not a chunk".to_owned());
    };
    let size = header.uncompressed_size;
    if size > MAX_RECORD_BYTES {
        return Err(format!(
            "it claims {size} bytes, more than the limit of {MAX_RECORD_BYTES}"
        ));
    }
    let records = match header.compression.as_str() {
        "" => data.into_owned(),
        "zstd" => read_bounded(
            zstd::stream::read::Decoder::new(&*data).map_err(|error| format!("zstd: {error}"))?,
            &header,
        )?,
        "lz4" => read_bounded(
            lz4::Decoder::new(&*data).map_err(|error| format!("lz4: {error}"))?,
            &header,
        )?,
        other => {
            return Err(format!(
                "its compression is {other:?}, expected zstd or lz4"
            ));
        }
    };
    if records.len() as u64 != size {
        return Err(format!(
            "expected {size} bytes after decompression, got {}",
            records.len()
        ));
    }
    // 0 means that the writer computed no CRC.
    let crc = crc32fast::hash(&records);
    if header.uncompressed_crc != 0 && crc != header.uncompressed_crc {
        return Err(format!(
            "expected CRC {:08x}, got {crc:08x}",
            header.uncompressed_crc
        ));
    }
    Ok(records.into())
}

/// Decompresses at most one byte more than the chunk claims, to bound the memory.
fn read_bounded(decoder: impl std::io::Read, header: &ChunkHeader) -> Result<Vec<u8>, String> {
    let mut records = Vec::new();
    decoder
        .take(header.uncompressed_size + 1)
        .read_to_end(&mut records)
        .map_err(|error| format!("{}: {error}", header.compression))?;
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn truncated_buffer_ends_with_one_error() {
        let mut bytes = vec![op::MESSAGE];
        bytes.extend(3u64.to_le_bytes());
        bytes.extend([1, 2, 3]);
        let whole: Vec<_> = Records::new(bytes.clone().into())
            .collect::<Result<_, _>>()
            .unwrap();
        assert_eq!(
            (whole.len(), whole[0].opcode, &whole[0].body[..]),
            (1, op::MESSAGE, &[1u8, 2, 3][..])
        );
        for end in 1..bytes.len() {
            let cut: Vec<_> = Records::new(Bytes::copy_from_slice(&bytes[..end])).collect();
            assert!(matches!(cut[..], [Err(_)]), "cut at {end}");
        }
    }

    #[test]
    fn chunk_with_wrong_size_is_rejected() {
        for (size, compression) in [
            (u64::MAX, ""),
            (MAX_RECORD_BYTES + 1, "zstd"),
            (5, ""),
            (5, "snappy"),
        ] {
            let mut body = Vec::new();
            body.extend(0u64.to_le_bytes());
            body.extend(0u64.to_le_bytes());
            body.extend(size.to_le_bytes());
            body.extend(0u32.to_le_bytes());
            body.extend((compression.len() as u32).to_le_bytes());
            body.extend(compression.as_bytes());
            body.extend(4u64.to_le_bytes());
            body.extend([0; 4]);
            assert!(decompress(&body).is_err(), "{size} {compression}");
        }
    }
}
