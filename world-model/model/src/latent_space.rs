//! Identity of a latent space.

use std::fmt;

use candle_core::Tensor;
use serde::{Deserialize, Serialize};

use crate::sampler::values::stacked;
use crate::{Error, Result};

/// What makes two latents comparable: who produced them and how they are laid out.
///
/// Two latents may be compared, predicted from or decoded together only if their spaces are equal.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LatentSpace {
    /// Name of the encoder, for people.
    pub name: String,
    /// SHA-256 (hexadecimal) over all that defines the space: the encoder's weights, the
    /// normalisation and the configuration.
    pub hash: String,
    /// Rows of the latent grid.
    pub height: usize,
    /// Columns of the latent grid.
    pub width: usize,
    /// Values at each place of the grid.
    pub channels: usize,
}

impl LatentSpace {
    /// Values of one latent.
    pub fn elements(&self) -> usize {
        self.height * self.width * self.channels
    }

    /// Shape of one latent: (height, width, channels).
    pub fn shape(&self) -> (usize, usize, usize) {
        (self.height, self.width, self.channels)
    }

    /// Latents of this space, each row-major with channels last, as one tensor (n, h, w, C) on the CPU.
    ///
    /// # Errors
    /// If one has another number of values.
    pub fn stack(&self, latents: &[&[f32]]) -> Result<Tensor> {
        stacked(
            "a latent",
            latents,
            &[self.height, self.width, self.channels],
        )
    }

    /// Checks that `other` is this same space.
    ///
    /// # Errors
    /// [`Error::LatentSpaceMismatch`] if name, hash or shape differ.
    pub fn require(&self, other: &Self) -> Result<()> {
        if self == other {
            return Ok(());
        }
        Err(Error::LatentSpaceMismatch {
            expected: Box::new(self.clone()),
            found: Box::new(other.clone()),
        })
    }
}

impl fmt::Display for LatentSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let short = self.hash.get(..12).unwrap_or(&self.hash);
        write!(
            f,
            "`{}` ({}x{}x{}, hash {short})",
            self.name, self.height, self.width, self.channels
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn space() -> LatentSpace {
        LatentSpace {
            name: "tiny".into(),
            hash: "0123456789abcdef".into(),
            height: 16,
            width: 16,
            channels: 8,
        }
    }

    #[test]
    fn a_space_accepts_itself() {
        assert!(space().require(&space()).is_ok());
        assert_eq!(space().elements(), 2048);
    }

    #[test]
    fn another_hash_is_refused_with_both_hashes_named() {
        let other = LatentSpace {
            hash: "fedcba9876543210".into(),
            ..space()
        };
        let message = space().require(&other).unwrap_err().to_string();
        assert!(message.contains("0123456789ab"), "{message}");
        assert!(message.contains("fedcba987654"), "{message}");
    }
}
