//! Messages that rosbag2 compressed individually (`compression_mode: MESSAGE`).

use bytes::Bytes;
use std::io::Read as _;

use super::{chunk::MAX_RECORD_BYTES, stored_file::ZSTD_MAGIC};

/// Decompresses a zstd frame; `None` if the bytes are not one. The bag's metadata is not needed: CDR begins with a zero
/// byte, so that a plain message never looks like a frame.
pub(crate) fn decompress(data: &[u8]) -> Option<Result<Bytes, String>> {
    if !data.starts_with(&ZSTD_MAGIC) {
        return None;
    }
    let decompress = || -> std::io::Result<Vec<u8>> {
        let decoder = zstd::stream::read::Decoder::with_buffer(data)?;
        let mut message = Vec::new();
        decoder
            .take(MAX_RECORD_BYTES + 1)
            .read_to_end(&mut message)?;
        Ok(message)
    };
    Some(match decompress() {
        Ok(message) if message.len() as u64 > MAX_RECORD_BYTES => Err(format!(
            "it has more than {MAX_RECORD_BYTES} bytes after decompression"
        )),
        Ok(message) => Ok(message.into()),
        Err(error) => Err(format!("zstd: {error}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_is_decompressed_within_a_limit() {
        assert!(decompress(&Bytes::from_static(&[0, 1, 0, 0, 9])).is_none());
        let frame = |bytes: &[u8]| Bytes::from(zstd::bulk::compress(bytes, 1).unwrap());
        let message = decompress(&frame(b"\0\x01\0\0text")).unwrap().unwrap();
        assert_eq!(&message[..], b"\0\x01\0\0text");
        let cut = frame(&[7; 1000]);
        assert!(decompress(&cut.slice(..cut.len() - 2)).unwrap().is_err());
        let bomb = frame(&vec![0; MAX_RECORD_BYTES as usize + 1]);
        assert!(bomb.len() < 100_000);
        assert!(
            decompress(&bomb)
                .unwrap()
                .unwrap_err()
                .contains("bytes after")
        );
    }
}
