use super::{
    ConvertError,
    output::Output,
    scalar::{Number, Scalar},
};

/// Representation identifier and two bytes of options.
const HEADER_BYTES: usize = 4;
/// RTPS pads a payload to a multiple of four bytes.
const MOST_PADDING: usize = 3;

/// The body of a message, read from front to back.
pub(super) struct Input<'a> {
    body: &'a [u8],
    at: usize,
    is_little: bool,
    /// 8 in CDR of version 1, 4 in version 2.
    largest_alignment: usize,
}

impl<'a> Input<'a> {
    /// Reads the header.
    pub fn open(bytes: &'a [u8]) -> Result<Self, ConvertError> {
        let (Some(representation), Some(body)) =
            (bytes.first_chunk::<2>(), bytes.get(HEADER_BYTES..))
        else {
            return Err(ConvertError::NoHeader(bytes.len()));
        };
        let (is_little, largest_alignment) = match u16::from_be_bytes(*representation) {
            0 => (false, 8),
            1 => (true, 8),
            6 => (false, 4),
            7 => (true, 4),
            other => return Err(ConvertError::Representation(other)),
        };
        Ok(Self {
            body,
            at: 0,
            is_little,
            largest_alignment,
        })
    }

    /// Position of the next field, without its alignment.
    pub fn place(&self) -> usize {
        self.at
    }

    /// Continues at a [`place`](Self::place).
    pub fn go_to(&mut self, place: usize) {
        self.at = place;
    }

    /// Checks that only padding is left.
    pub fn end(&self) -> Result<(), ConvertError> {
        let length = self.body.len();
        if length.saturating_sub(self.at) > MOST_PADDING {
            let used = self.at;
            return Err(ConvertError::Trailing { used, length });
        }
        Ok(())
    }

    /// The next bytes, aligned.
    fn bytes(&mut self, alignment: usize, length: u64) -> Result<&'a [u8], ConvertError> {
        let at = match length {
            // An empty sequence of numbers has no padding after its length.
            0 => self.at,
            _ => self
                .at
                .next_multiple_of(alignment.min(self.largest_alignment)),
        };
        // Alignment may lead past the end, where no byte is left.
        let left = self.body.get(at..).unwrap_or(&[]);
        let taken = usize::try_from(length)
            .ok()
            .and_then(|length| left.get(..length));
        let taken = taken.ok_or(ConvertError::TooShort {
            at,
            expected: length,
            left: left.len(),
        })?;
        self.at = at + taken.len();
        Ok(taken)
    }

    fn number(&self, bytes: &[u8]) -> u64 {
        let mut value = [0; 8];
        for (place, byte) in value.iter_mut().zip(bytes) {
            *place = *byte;
        }
        match self.is_little {
            true => u64::from_le_bytes(value),
            // They are the first bytes of the value.
            false => u64::from_be_bytes(value) >> (8 * (8 - bytes.len().clamp(1, 8))),
        }
    }

    /// The number of a sequence's elements; each takes at least a byte.
    pub fn count(&mut self) -> Result<u64, ConvertError> {
        let bytes = self.bytes(4, 4)?;
        let count = self.number(bytes);
        let left = self.body.len() - self.at;
        if count > left as u64 {
            return Err(ConvertError::TooShort {
                at: self.at,
                expected: count,
                left,
            });
        }
        Ok(count)
    }

    /// A string, without its zero byte.
    pub fn text(&mut self) -> Result<&'a [u8], ConvertError> {
        let length = self.count()?;
        let at = self.at;
        match self.bytes(1, length)?.split_last() {
            // Some writers give an empty string no byte.
            None => Ok(&[]),
            Some((0, text)) => Ok(text),
            Some(_) => Err(ConvertError::Text { at }),
        }
    }

    /// Skips numbers of this size.
    pub fn skip(&mut self, size: usize, count: u64) -> Result<(), ConvertError> {
        self.bytes(size, count.saturating_mul(size as u64))
            .map(drop)
    }

    /// Copies numbers, as wider ones if the target's are wider.
    pub fn scalars(
        &mut self,
        from: Scalar,
        to: Scalar,
        count: u64,
        output: &mut Output,
    ) -> Result<(), ConvertError> {
        let size = from.size();
        let bytes = self.bytes(size, count.saturating_mul(size as u64))?;
        // Types of one size are equal, or byte and uint8.
        if size == to.size() && (self.is_little || size == 1) {
            return output.bytes(size, bytes);
        }
        for bytes in bytes.chunks_exact(size) {
            let bits = self.number(bytes);
            let number = match from {
                Scalar::Float(4) => Number::Float(f64::from(f32::from_bits(bits as u32))),
                Scalar::Float(_) => Number::Float(f64::from_bits(bits)),
                Scalar::Signed(_) => {
                    let shift = 8 * (8 - size);
                    Number::Signed(((bits << shift) as i64) >> shift)
                }
                Scalar::Bool | Scalar::Byte | Scalar::Unsigned(_) => Number::Unsigned(bits),
            };
            match (from, to) {
                // Not by way of f64, which may change the payload of a NaN.
                (Scalar::Float(4), Scalar::Float(4)) => {
                    output.bytes(4, &(bits as u32).to_le_bytes())?;
                }
                _ => output.number(number, to)?,
            }
        }
        Ok(())
    }
}
