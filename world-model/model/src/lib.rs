//! A world model: pictures to latents, latents and actions to the next latents, and latents to pictures.
//!
//! | Item | Purpose |
//! |---|---|
//! | [`Encoder`], [`Decoder`] | pictures to latents and back; an [`Autoencoder`] does both |
//! | [`LatentSpace`] | identity and shape of latents: only latents of one space may be compared, predicted from or decoded |
//! | [`WorldModel`] | a loaded transition model with its latent space and its actions |
//! | [`sampler::Rollout`] | predictions, one model step after the other |
//! | [`Compute`] | device, number format and kernels |
//! | [`Framing`], [`Fit`] | how a camera's picture becomes the image of an encoder |
//! | [`Weights`] | files of tensors, with metadata |
//! | [`trained_folder`] | the embedded default `tiny`, and folders with an autoencoder |
//! | [`transition`], [`ops`] | the transition model, and the kernels under it |
//! | [`random`] | random tensors for tests and benchmarks |
//!
//! Latents and actions are plain values, row-major with channels last, or tensors of candle. Two predictions:
//!
//! ```
//! use wm_model::sampler::{Noise, Observed, Rollout};
//! use wm_model::trained_folder::TrainedFolder;
//! use wm_model::{Compute, Decoder as _, Encoder as _};
//!
//! # fn main() -> wm_model::Result<()> {
//! let tiny = TrainedFolder::Embedded;
//! let autoencoder = tiny.autoencoder()?;
//! let model = tiny.world_model(&Compute::default())?;
//!
//! let picture = image::RgbImage::new(640, 480);
//! let latent = autoencoder.values(&autoencoder.prepare(&picture)?)?;
//! let observed = Observed {
//!     frames: vec![&latent],
//!     actions: vec![],
//!     noise: Noise { seed: 1, first_step: 0 },
//! };
//! let sampler = &model.transition.config().sampler;
//! let mut rollout = Rollout::of_values(&model.transition, sampler, &[observed])?;
//! let action = vec![0.0; model.encoding.action_dim()];
//! for _ in 0..2 {
//!     let next = rollout.predict(&[&action], None)?.concat();
//!     assert_eq!(autoencoder.picture(&next)?.dimensions(), (128, 128));
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Equal inputs and seeds give equal bytes. The crate knows no ROS, no DDS and no clock, and it does not train: see
//! `wm_training`. Published networks are in `wm_zoo`.

mod compute;
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
mod world_model;

pub mod autoencoder;
pub mod image;
pub mod ops;
pub mod random;
pub mod sampler;
pub mod trained_folder;
pub mod transition;
pub mod weights;

pub use autoencoder::{Autoencoder, AutoencoderConfig};
pub use compute::{Compute, Kernels, NumberFormat};
pub use decoder::Decoder;
pub use encoder::Encoder;
pub use error::{Error, Result};
pub use framing::{BARS, Fit, Framing, Part, PictureSize, Placement};
pub use latent_space::LatentSpace;
pub use weights::Weights;
pub use world_model::WorldModel;
