//! Messages as bytes: the 4-byte encapsulation header and plain CDR (XCDR version 1), as ROS 2 puts them on the
//! wire and into bags.

use serde::{Serialize, de::DeserializeOwned};

/// Representation identifier of big-endian plain CDR.
const CDR_BE: [u8; 2] = [0x00, 0x00];
/// Representation identifier of little-endian plain CDR.
const CDR_LE: [u8; 2] = [0x00, 0x01];
/// Representation identifier and two bytes of options.
const HEADER_LEN: usize = 4;
/// RTPS pads a payload to a multiple of four bytes. More bytes after a message mean that it has a different type.
const MAX_PADDING: usize = 3;

/// A failure to decode or encode a message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// Fewer bytes than the encapsulation header has.
    #[error("expected a {HEADER_LEN}-byte CDR header, got {0} bytes")]
    NoHeader(usize),
    /// A representation other than plain CDR.
    #[error("expected plain CDR (representation 0x0000 or 0x0001), got 0x{0:02x}{1:02x}")]
    Representation(u8, u8),
    /// The body does not fit the type.
    #[error("cannot decode {type_name} from {len} bytes: {source}")]
    Decode {
        /// The Rust type that was requested.
        type_name: &'static str,
        /// Bytes given, header included.
        len: usize,
        /// The decoder's error.
        source: cdr_encoding::Error,
    },
    /// More bytes follow than padding has.
    #[error("expected {type_name} to end after {used} bytes, got {len}")]
    Trailing {
        /// The Rust type that was requested.
        type_name: &'static str,
        /// Bytes that the type needs, header included.
        used: usize,
        /// Bytes given, header included.
        len: usize,
    },
    /// A sequence without a known length, which CDR cannot encode. No type of this crate has one.
    #[error("cannot encode {type_name}: {source}")]
    Encode {
        /// The Rust type that was given.
        type_name: &'static str,
        /// The encoder's error.
        source: cdr_encoding::Error,
    },
}

/// The type's name without its modules.
fn name_of<T>() -> &'static str {
    let name = std::any::type_name::<T>();
    match name.contains('<') {
        true => name,
        false => name.rsplit_once("::").map_or(name, |(_, own)| own),
    }
}

/// Encodes a value: header (little endian) and body. The value may be a message, or one half of a service.
///
/// # Errors
/// A sequence without a known length. No type of this crate has one.
pub fn to_bytes<T: Serialize>(value: &T) -> Result<Vec<u8>, CdrError> {
    let mut bytes = vec![CDR_LE[0], CDR_LE[1], 0, 0];
    cdr_encoding::to_writer::<T, byteorder::LittleEndian, _>(&mut bytes, value).map_err(
        |source| CdrError::Encode {
            type_name: name_of::<T>(),
            source,
        },
    )?;
    Ok(bytes)
}

/// Decodes a value from header and body, of either byte order. Any bytes give a value or an error; memory is
/// bounded by a small multiple of their length.
///
/// # Errors
/// Bytes that are not plain CDR of this type; see [`CdrError`].
pub fn from_bytes<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    let type_name = name_of::<T>();
    let len = bytes.len();
    let (Some(&representation), Some(body)) = (bytes.first_chunk::<2>(), bytes.get(HEADER_LEN..))
    else {
        return Err(CdrError::NoHeader(len));
    };
    let (value, used) = match representation {
        CDR_LE => cdr_encoding::from_bytes::<T, byteorder::LittleEndian>(body),
        CDR_BE => cdr_encoding::from_bytes::<T, byteorder::BigEndian>(body),
        [high, low] => return Err(CdrError::Representation(high, low)),
    }
    .map_err(|source| CdrError::Decode {
        type_name,
        len,
        source,
    })?;
    if body.len().saturating_sub(used) > MAX_PADDING {
        return Err(CdrError::Trailing {
            type_name,
            used: used + HEADER_LEN,
            len,
        });
    }
    Ok(value)
}
