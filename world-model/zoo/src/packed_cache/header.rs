//! What the first bytes of a file of packed weights say.
//!
//! ```text
//! 0   8 bytes   "wmpacked"
//! 8   u32       version of this form, little-endian
//! 12  u32       length of the description, little-endian
//! 16  32 bytes  SHA-256 of the description
//! 48            description: JSON
//!               zeros up to the first matrix; each matrix starts on a multiple of 4096 bytes
//! ```

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use wm_model::NumberFormat;

use super::identity::Identity;

const MAGIC: &[u8; 8] = b"wmpacked";
const VERSION: u32 = 1;
/// Bytes before the description.
const FIXED: usize = 48;
/// A description of a hundred thousand matrices is shorter.
const MOST_DESCRIPTION: usize = 32 << 20;
/// Matrices start on pages, and so on whole cache lines.
pub(super) const ALIGNMENT: u64 = 4096;

/// What a file holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Header {
    /// The checkpoint's path, for people.
    pub(super) weights: String,
    pub(super) identity: Identity,
    /// [`wm_model::ops::packed_layout`].
    pub(super) layout: String,
    pub(super) matrices: Vec<Matrix>,
    /// Bytes of the whole file.
    pub(super) length: u64,
}

/// A packed matrix.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Matrix {
    pub(super) name: String,
    pub(super) outputs: usize,
    pub(super) inputs: usize,
    pub(super) format: NumberFormat,
    /// First byte, from the start of the file.
    pub(super) start: u64,
    pub(super) bytes: u64,
    pub(super) crc32: u32,
}

/// Why a file is of no use.
#[derive(Debug, thiserror::Error)]
pub(super) enum Refusal {
    #[error(transparent)]
    Io(#[from] std::io::Error),
    #[error("it is no file of packed weights")]
    Foreign,
    #[error("it is of version {0}, expected {VERSION}")]
    Version(u32),
    #[error("its description is damaged: {0}")]
    Description(String),
    #[error("it has {found} bytes, expected {expected}")]
    Length { expected: u64, found: u64 },
    #[error("`{0}` does not lie within it")]
    Place(String),
    #[error("`{0}` is damaged")]
    Damaged(String),
    #[error("the checkpoint is another one, or has changed")]
    Checkpoint,
    #[error("it is packed as {found}, expected {expected}")]
    Layout { expected: String, found: String },
}

impl Header {
    /// Says where `matrices` go, whose places are not known yet.
    pub(super) fn arrange(&mut self) -> Result<(), Refusal> {
        // Numbers that are not known yet may be longer: room for each at its longest.
        let room = self.matrices.len() * 3 * 20 + 20;
        let described = self.description()?.len() + room;
        let mut next = ((FIXED + described) as u64).next_multiple_of(ALIGNMENT);
        for matrix in &mut self.matrices {
            matrix.start = next;
            self.length = next + matrix.bytes;
            next = self.length.next_multiple_of(ALIGNMENT);
        }
        Ok(())
    }

    fn description(&self) -> Result<Vec<u8>, Refusal> {
        serde_json::to_vec(self).map_err(|e| Refusal::Description(e.to_string()))
    }

    /// The bytes before the first matrix, but for zeros at the end.
    pub(super) fn encode(&self) -> Result<Vec<u8>, Refusal> {
        let description = self.description()?;
        let length = u32::try_from(description.len());
        let length = length.map_err(|e| Refusal::Description(e.to_string()))?;
        let mut bytes = Vec::with_capacity(FIXED + description.len());
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&length.to_le_bytes());
        bytes.extend_from_slice(&Sha256::digest(&description));
        bytes.extend_from_slice(&description);
        Ok(bytes)
    }

    /// Reads the header of the file `bytes`; every matrix lies within the file and is aligned.
    pub(super) fn decode(bytes: &[u8]) -> Result<Self, Refusal> {
        let Some((fixed, rest)) = bytes.split_first_chunk::<FIXED>() else {
            return Err(Refusal::Foreign);
        };
        let Some(fixed) = fixed.strip_prefix(MAGIC) else {
            return Err(Refusal::Foreign);
        };
        let ([version, length], hash) = match fixed.as_chunks::<4>() {
            ([version, length, hash @ ..], []) => ([version, length], hash.as_flattened()),
            _ => return Err(Refusal::Foreign),
        };
        let version = u32::from_le_bytes(*version);
        if version != VERSION {
            return Err(Refusal::Version(version));
        }
        let length = u32::from_le_bytes(*length) as usize;
        let damaged = |reason: String| Refusal::Description(reason);
        if length > MOST_DESCRIPTION {
            return Err(damaged(format!("{length} bytes of it")));
        }
        let Some(description) = rest.get(..length) else {
            return Err(damaged(format!("{} of {length} bytes", rest.len())));
        };
        if Sha256::digest(description).as_slice() != hash {
            return Err(damaged("another SHA-256".to_owned()));
        }
        let header: Self =
            serde_json::from_slice(description).map_err(|e| damaged(e.to_string()))?;
        let found = bytes.len() as u64;
        if header.length != found {
            return Err(Refusal::Length {
                expected: header.length,
                found,
            });
        }
        let first = (FIXED + length) as u64;
        for matrix in &header.matrices {
            let end = matrix.start.checked_add(matrix.bytes);
            let is_within = matrix.start >= first && end.is_some_and(|end| end <= found);
            if !is_within || !matrix.start.is_multiple_of(ALIGNMENT) {
                return Err(Refusal::Place(matrix.name.clone()));
            }
        }
        Ok(header)
    }
}
