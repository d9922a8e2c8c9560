//! Recognises records by their content, since their lengths may be damaged.

use mcap::records::op;

use crate::reader::record::bytes_after_fields;

/// Number of bytes that identify a chunk's body.
pub(super) const CHUNK_PREFIX: usize = 48;
/// Size of the fixed part of a message's body: channel, sequence number, two times.
pub(super) const MESSAGE_PREFIX: u64 = 22;

/// Whether a body of `length` bytes with this prefix is a chunk's: its inner lengths agree with `length`, and MCAP knows
/// its compression. No other record passes, whatever its opcode.
pub(super) fn is_chunk(prefix: &[u8], length: u64) -> bool {
    // Times, size, CRC; then compression name and records, each after its length.
    const TO_COMPRESSION: usize = 8 + 8 + 8 + 4;
    let Some((&name_length, rest)) = prefix
        .get(TO_COMPRESSION..)
        .and_then(|rest| rest.split_first_chunk::<4>())
    else {
        return false;
    };
    let name_length = u32::from_le_bytes(name_length) as usize;
    let Some((name, rest)) = rest.split_at_checked(name_length) else {
        return false;
    };
    let Some(records) = rest.first_chunk::<8>() else {
        return false;
    };
    let before_records = (TO_COMPRESSION + 4 + name_length + 8) as u64;
    matches!(name, b"" | b"lz4" | b"zstd")
        && u64::from_le_bytes(*records).checked_add(before_records) == Some(length)
}

/// Whether a body has exactly the fields of its opcode. Messages, attachments and unknown records always pass.
pub(super) fn is_exact(opcode: u8, body: &[u8]) -> bool {
    opcode == op::ATTACHMENT || bytes_after_fields(opcode, body).is_some_and(<[u8]>::is_empty)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunk_is_recognised_by_consistent_lengths() {
        let chunk = |name: &[u8], records: u64| {
            let mut body = vec![0; 28];
            body.extend((name.len() as u32).to_le_bytes());
            body.extend(name);
            body.extend(records.to_le_bytes());
            body
        };
        for (body, length, is) in [
            (chunk(b"zstd", 100), 44 + 100, true),
            (chunk(b"", 0), 40, true),
            (chunk(b"zstd", 100), 143, false),
            (chunk(b"zstd", u64::MAX), 43, false),
            (chunk(b"nope", 100), 144, false),
            (vec![0xff; 48], 48, false),
            (vec![], 0, false),
        ] {
            assert_eq!(is_chunk(&body, length), is, "{body:?} {length}");
        }
    }

    #[test]
    fn body_with_other_fields_is_not_exact() {
        assert!(is_exact(op::MESSAGE_INDEX, &[1, 0, 2, 0, 0, 0, 9, 9]));
        assert!(!is_exact(op::MESSAGE_INDEX, &[1, 0, 2, 0, 0, 0, 9, 9, 9]));
        assert!(!is_exact(op::MESSAGE_INDEX, &[1, 0, 255, 255, 255, 255]));
        assert!(is_exact(op::DATA_END, &[0; 4]));
        assert!(!is_exact(op::MESSAGE, &[0; 21]));
    }
}
