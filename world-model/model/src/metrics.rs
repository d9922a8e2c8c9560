//! Image metrics: how similar a decoded prediction is to the camera's frame.
//!
//! [`psnr`] and [`ssim`] are over 8-bit RGB with data range 255; [`masked_psnr`] counts only the pixels of a mask, since
//! a still background flatters every other figure. Latent errors need no more than [`mean_squared_error`].
//!
//! SSIM is written here because the crate at hand (`image-compare`) fixes blocks of 8x8 that do not overlap, where the
//! figures of the field use a 7x7 uniform window at every pixel.

mod psnr;
mod ssim;

use thiserror::Error;

pub use psnr::{masked_psnr, mean_squared_error, psnr};
pub use ssim::{SSIM_WINDOW, ssim};

/// Why a metric has no value.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum MetricError {
    /// The two images, or an image and its mask, differ in size (width, height).
    #[error("sizes differ: {first:?} against {second:?} (width, height)")]
    Size {
        /// Size of the first.
        first: (u32, u32),
        /// Size of the second.
        second: (u32, u32),
    },
    /// Smaller than the window of the metric.
    #[error("an image of {size:?} (width, height) is smaller than the window of {window}x{window}")]
    TooSmall {
        /// The image's size.
        size: (u32, u32),
        /// The window's side.
        window: u32,
    },
    /// Nothing to count: no pixel, an empty mask, or no value.
    #[error("nothing to compare: the images, or the mask, are empty")]
    Empty,
    /// Two vectors of different length.
    #[error("lengths differ: {first} against {second} values")]
    Length {
        /// Length of the first.
        first: usize,
        /// Length of the second.
        second: usize,
    },
}
