//! The model library: every architecture of the paper, loadable from the checkpoints that its authors published.
//!
//! | Model | Item |
//! |---|---|
//! | Convolutional autoencoders, vision transformers, EfficientNet-Lite0 | [`kinds`] |
//! | The pixel decoder | [`PixelDecoder`] |
//! | The S-VAE adapter | [`Svae`] |
//! | A small semantic encoder | [`WebDino`] |
//! | Inverse dynamics, success probes | [`idm`], [`success_probe`], [`pooled_probe`] |
//! | LPIPS | [`lpips`] |
//! | A whole world model of these, for the nodes | [`folder`] |
//! | The transition model (DiT) | [`wm_model::transition`], configured by [`kinds`] |
//!
//! A [`Checkpoint`] is an open file of tensors. A [`Loader`] gives them to a model by their published names and reports
//! all that do not fit, for the device, number format and kernels of a [`Compute`](wm_model::Compute). [`kinds`] runs any of the models on
//! a file of tensors, [`cost`] counts parameters and operations.
//!
//! ```
//! use wm_model::Kernels;
//! use wm_zoo::{Loader, PixelDecoder, PixelDecoderConfig};
//!
//! # fn main() -> wm_zoo::Result<()> {
//! // Without weights: the tensors that a model needs.
//! let loader = Loader::skeleton(Kernels::Cpu);
//! PixelDecoder::load(&PixelDecoderConfig::paper(), &loader)?;
//! assert_eq!((loader.parameters() as f64 / 1e6).round(), 177.0);
//! # Ok(())
//! # }
//! ```
//!
//! The crate does not train, but a network whose tensors are variables ([`Loader::supplied`]) propagates gradients to
//! them. Elsewhere: sampling and planning (`wm_model`), files of other formats than safetensors and torch's, and
//! downloads (`wm model fetch`).

mod error;
mod model_folder;
mod sizes;
mod unfinished;

pub mod calibration;
pub mod checkpoint;
pub mod cost;
pub mod folder;
pub mod kinds;
pub mod loader;
pub mod packed_cache;

pub mod distance;
mod efficientnet_lite0;
pub mod idm;
mod layers;
pub mod lpips;
pub mod pooled_probe;
pub mod subgoals;
pub mod success_probe;
mod svae;
mod vae;
mod vit;

pub use calibration::Calibration;
pub use checkpoint::Checkpoint;
pub use error::{Error, Misshapen, Result};
pub use layers::Dropout;
pub use loader::{Loader, Supply};
pub use model_folder::{ModelFolder, TransitionTensors};
pub use packed_cache::PackedCache;
pub use svae::{Svae, SvaeConfig};
pub use unfinished::Unfinished;
pub use vae::{PixelDecoder, PixelDecoderConfig};
pub use vit::{WebDino, WebDinoConfig};
pub use wm_model::trained_folder::{DISTANCE_FILE, IDM_FILE, PROBE_FILE, SUBGOALS_FILE};
