//! Convolutional encoders and decoders: images to latents and back.
//!
//! | module | encoder | decoder | latent of a 256x256 image |
//! |---|---|---|---|
//! | [`sd3`] | [`SdVaeEncoder`] | [`SdVaeDecoder`] | 32x32x16 |
//! | [`va_vae`] | [`VaVaeEncoder`] | [`VaVaeDecoder`] | 16x16x32 |
//! | [`cosmos`] | [`CosmosEncoder`] | [`CosmosDecoder`] | 16x16x16 |
//! | [`pixel_decoder`] | | [`PixelDecoder`] | 16x16x96, from the S-VAE adapter |
//!
//! Images are (N, H, W, 3) f32 in 0..1 and latents (N, h, w, C) f32, whatever number format the weights are
//! held in. Encoding is deterministic: where a network predicts a distribution, the latent is its mean. Any
//! size is taken that the network's downsampling divides, so nothing here asks for 256x256.
//!
//! The three autoencoders are one family (the convolutional autoencoder of latent diffusion, Rombach et al.
//! 2022) with other widths, key names and ends; what they share is in `tower` and `blocks`.
//!
//! Not here: sampling from the predicted distribution, tiling of large images, training.

mod blocks;
pub(crate) mod cosmos;
pub(crate) mod haar;
mod naming;
pub(crate) mod pixel_decoder;
pub(crate) mod sd3;
mod seam;
mod tower;
pub(crate) mod va_vae;

#[cfg(test)]
mod tests;

pub(crate) use cosmos::{CosmosConfig, CosmosDecoder, CosmosEncoder};
pub use pixel_decoder::{PixelDecoder, PixelDecoderConfig};
pub(crate) use sd3::{SdVaeConfig, SdVaeDecoder, SdVaeEncoder};
pub(crate) use va_vae::{VaVaeConfig, VaVaeDecoder, VaVaeEncoder};
