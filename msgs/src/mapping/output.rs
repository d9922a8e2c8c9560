use super::{
    ConvertError,
    scalar::{Number, Scalar},
};

/// Limit of a message \[byte\], far above any message of this suite: a hostile bag could enlarge a small message without end.
const LARGEST: usize = 512 << 20;
/// Little-endian plain CDR of version 1.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// A message while it is written, as little-endian plain CDR.
#[derive(Default)]
pub(super) struct Output {
    /// Without the header.
    body: Vec<u8>,
}

impl Output {
    /// The message with its header.
    pub fn into_bytes(mut self) -> Vec<u8> {
        self.body.splice(..0, HEADER);
        self.body
    }

    /// Bytes of elements with this alignment.
    pub fn bytes(&mut self, alignment: usize, bytes: &[u8]) -> Result<(), ConvertError> {
        if bytes.is_empty() {
            return Ok(());
        }
        let at = self.body.len().next_multiple_of(alignment);
        if at.saturating_add(bytes.len()) > LARGEST {
            return Err(ConvertError::TooLarge { limit: LARGEST });
        }
        self.body.resize(at, 0);
        self.body.extend_from_slice(bytes);
        Ok(())
    }

    /// The number of a sequence's elements, at most the length of the input.
    pub fn count(&mut self, count: u64) -> Result<(), ConvertError> {
        let count = u32::try_from(count).map_err(|_| ConvertError::TooLarge { limit: LARGEST })?;
        self.bytes(4, &count.to_le_bytes())
    }

    /// A number of zero.
    pub fn zero(&mut self, size: usize) -> Result<(), ConvertError> {
        self.bytes(size, first_bytes(&[0; 8], size))
    }

    /// A string, given without its zero byte, of at most `limit` bytes.
    pub fn text(
        &mut self,
        text: &[u8],
        field: &str,
        limit: Option<u64>,
    ) -> Result<(), ConvertError> {
        let found = text.len() as u64;
        if let Some(limit) = limit.filter(|limit| found > *limit) {
            return Err(ConvertError::Bound {
                field: field.to_owned(),
                limit,
                found,
            });
        }
        self.count(found + 1)?;
        self.bytes(1, text)?;
        self.bytes(1, &[0])
    }

    /// A number as a type that holds it.
    pub fn number(&mut self, number: Number, to: Scalar) -> Result<(), ConvertError> {
        let size = to.size();
        let bits = match (number, to) {
            (Number::Signed(value), Scalar::Float(4)) => u64::from((value as f32).to_bits()),
            (Number::Unsigned(value), Scalar::Float(4)) => u64::from((value as f32).to_bits()),
            (Number::Float(value), Scalar::Float(4)) => u64::from((value as f32).to_bits()),
            (Number::Signed(value), Scalar::Float(_)) => (value as f64).to_bits(),
            (Number::Unsigned(value), Scalar::Float(_)) => (value as f64).to_bits(),
            (Number::Float(value), _) => value.to_bits(),
            (Number::Signed(value), _) => value as u64,
            (Number::Unsigned(value), _) => value,
        };
        self.bytes(size, first_bytes(&bits.to_le_bytes(), size))
    }
}

/// The low bytes of a number of this size, which is at most 8.
fn first_bytes(bytes: &[u8; 8], size: usize) -> &[u8] {
    debug_assert!(size <= bytes.len(), "a number of {size} bytes");
    bytes.get(..size).unwrap_or(bytes)
}
