//! Parses MCAP records after checking every length in them.

use mcap::{
    parse_record,
    records::{Record, op},
};

/// A field of a record's body.
enum Part {
    /// A fixed number of bytes.
    Fixed(usize),
    /// Bytes after their number (4 bytes).
    Text,
    /// As [`Text`](Self::Text), with pairs of texts as content.
    Map,
    /// Bytes after their number (8 bytes).
    Long,
}

/// Parses a record. The library allocates memory by the lengths in the record before it reads, so they are checked first.
///
/// # Errors
/// A length exceeds the record, or a field is invalid.
pub(crate) fn parse(opcode: u8, body: &[u8]) -> Result<Record<'_>, String> {
    if bytes_after_fields(opcode, body).is_none() {
        let size = body.len();
        return Err(format!(
            "a length in the record (opcode {opcode:#04x}) exceeds its {size} bytes"
        ));
    }
    parse_record(opcode, body).map_err(|error| error.to_string())
}

/// The bytes after the fields of a record; `None` if a length exceeds the body. Empty for opcodes without known fields.
pub(crate) fn bytes_after_fields(opcode: u8, body: &[u8]) -> Option<&[u8]> {
    use Part::{Fixed, Long, Map, Text};
    let parts: &[Part] = match opcode {
        op::HEADER => &[Text, Text],
        op::FOOTER => &[Fixed(20)],
        op::SCHEMA => &[Fixed(2), Text, Text, Text],
        op::CHANNEL => &[Fixed(4), Text, Text, Map],
        op::MESSAGE => {
            body.get(22..)?;
            return Some(&[]);
        }
        op::CHUNK => &[Fixed(28), Text, Long],
        op::MESSAGE_INDEX => &[Fixed(2), Text],
        op::CHUNK_INDEX => &[Fixed(32), Text, Fixed(8), Text, Fixed(16)],
        op::ATTACHMENT => &[Fixed(16), Text, Text, Long, Fixed(4)],
        op::ATTACHMENT_INDEX => &[Fixed(40), Text, Text],
        op::STATISTICS => &[Fixed(42), Text],
        op::METADATA => &[Text, Map],
        op::METADATA_INDEX => &[Fixed(16), Text],
        op::SUMMARY_OFFSET => &[Fixed(17)],
        op::DATA_END => &[Fixed(4)],
        _ => return Some(&[]),
    };
    let mut left = body;
    for part in parts {
        left = match part {
            Fixed(length) => left.get(*length..)?,
            Text => split_text(left)?.1,
            Map => {
                let (mut pairs, behind) = split_text(left)?;
                while !pairs.is_empty() {
                    pairs = split_text(pairs)?.1;
                }
                behind
            }
            Long => {
                let (length, behind) = left.split_first_chunk::<8>()?;
                behind.get(usize::try_from(u64::from_le_bytes(*length)).ok()?..)?
            }
        };
    }
    Some(left)
}

/// Splits off a text with its length.
fn split_text(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, behind) = bytes.split_first_chunk::<4>()?;
    behind.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A channel record's body: two ids, topic, encoding, one pair of metadata.
    fn channel() -> Vec<u8> {
        let mut body = vec![1, 0, 1, 0];
        let mut text = |text: &str| {
            body.extend((text.len() as u32).to_le_bytes());
            body.extend(text.as_bytes());
        };
        ["/topic", "cdr"].iter().for_each(|field| text(field));
        body.extend(13u32.to_le_bytes());
        let mut text = |text: &str| {
            body.extend((text.len() as u32).to_le_bytes());
            body.extend(text.as_bytes());
        };
        ["key", "va"].iter().for_each(|field| text(field));
        body
    }

    #[test]
    fn length_beyond_the_record_is_rejected() {
        let whole = channel();
        assert!(
            matches!(parse(op::CHANNEL, &whole), Ok(Record::Channel(c)) if c.metadata["key"] == "va")
        );
        // The lengths of topic, encoding, metadata, key and value.
        for at in [4, 14, 21, 25, 32] {
            let mut lying = whole.clone();
            lying[at..at + 4].copy_from_slice(&[255; 4]);
            let error = parse(op::CHANNEL, &lying).unwrap_err();
            assert!(error.contains("exceeds its 38 bytes"), "{error}");
        }
    }

    proptest! {
        /// Any bytes give a record or an error, within memory of their size.
        #[test]
        fn parser_survives_arbitrary_bytes(opcode in any::<u8>(), body in prop::collection::vec(any::<u8>(), 0..80)) {
            parse(opcode, &body).ok();
        }
    }
}
