//! The world model: encoders, decoders, the latent transition model, and its sampler.
//!
//! A frozen [`Encoder`] turns camera frames into latents, a transition model predicts the next
//! latent from the last ones and an action, and a [`Decoder`] turns latents into pictures.
//!
//! This crate is a library of numbers in, numbers out. It knows no ROS, no DDS and no clock, and it
//! does not train: training lives in `wm_training`.

// Without the feature, its tests alone.
#[cfg(any(test, feature = "cuda"))]
#[cfg_attr(
    not(feature = "cuda"),
    allow(dead_code, reason = "its tests do not call the libraries")
)]
mod cuda;
mod decoder;
mod encoder;
mod error;
mod framing;
mod latent_space;
mod place;
mod world_model;

pub mod autoencoder;
pub mod image;
pub mod ops;
pub mod sampler;
pub mod trained_folder;
pub mod transition;
pub mod weights;

pub use autoencoder::{Autoencoder, AutoencoderConfig};
#[cfg(feature = "cuda")]
pub use cuda::load as load_cuda;
pub use decoder::Decoder;
pub use encoder::Encoder;
pub use error::{Error, Result};
pub use framing::{BARS, Fit, Framing, Part, PictureSize, Placement};
pub use latent_space::LatentSpace;
pub use place::Place;
pub use weights::Weights;
pub use world_model::WorldModel;
