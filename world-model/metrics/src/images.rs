//! Image metrics: similarity of a decoded prediction to the camera's frame (the paper, appendix C.2).
//!
//! [`psnr`] and [`ssim`] compare 8-bit RGB with data range 255. [`masked_psnr`] counts only the pixels of a mask, since
//! a still background raises all other metrics. [`mean_squared_error`] serves latents.
//!
//! The paper's SSIM is "computed on luminance with a local window", which is [`ssim_luminance`]; [`ssim`] in colour
//! with a uniform window is scikit-image's default. They are not interchangeable.
//!
//! SSIM is written here because `image-compare` has fixed 8x8 blocks without overlap, while the usual definition has a
//! window at every pixel.

mod luminance;
pub(crate) mod psnr;
mod ssim;

pub use luminance::{SSIM_LUMINANCE_WINDOW, ssim_luminance};
pub use psnr::{masked_psnr, mean_squared_error, psnr};
pub use ssim::{SSIM_WINDOW, ssim};
