//! The size of a picture.

use std::fmt;

use image::RgbImage;
use serde::{Deserialize, Serialize};

/// Columns and rows of a camera's picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PictureSize {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl PictureSize {
    /// The size of `picture`.
    pub fn of(picture: &RgbImage) -> Self {
        let (width, height) = picture.dimensions();
        Self { width, height }
    }

    /// Whether width / height is the same in both.
    pub fn has_aspect_of(self, other: Self) -> bool {
        self.cross(other) == other.cross(self)
    }

    pub(super) fn cross(self, other: Self) -> u64 {
        u64::from(self.width) * u64::from(other.height)
    }

    pub(super) fn is_empty(self) -> bool {
        self.width == 0 || self.height == 0
    }
}

/// As drivers write it: `640x480` has 640 columns.
impl fmt::Display for PictureSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}
