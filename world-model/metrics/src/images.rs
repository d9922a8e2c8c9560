//! Image metrics: how similar a decoded prediction is to the camera's frame (the paper, appendix C.2).
//!
//! [`psnr`] and [`ssim`] are over 8-bit RGB with data range 255; [`masked_psnr`] counts only the pixels of a mask, since
//! a still background flatters every other figure. Latent errors need no more than [`mean_squared_error`].
//!
//! The paper's SSIM is "computed on luminance with a local window", which is [`ssim_luminance`]; [`ssim`] in colour over
//! a uniform window is what scikit-image computes unless told otherwise. Neither stands for the other in a table.
//!
//! SSIM is written here because the crate at hand (`image-compare`) fixes blocks of 8x8 that do not overlap, where the
//! figures of the field have a window at every pixel.

mod luminance;
pub(crate) mod psnr;
mod ssim;

pub use luminance::{SSIM_LUMINANCE_WINDOW, ssim_luminance};
pub use psnr::{masked_psnr, mean_squared_error, psnr};
pub use ssim::{SSIM_WINDOW, ssim};
