//! Training of the world model from bags: the autoencoder, then the transition model on its frozen latents.
//!
//! Not here: the models themselves and inference (`wm_model`), making data (`wm_sim`, `wm_import`).

pub mod arguments;
pub mod autoencoder;
pub mod dataset;
pub mod distill;
pub mod fresh_weights;
pub mod idm;
pub mod latents;
pub mod model;
pub mod model_folder;
pub mod optimiser;
pub mod probe;
pub mod recipe;
pub mod run;
pub mod squared_error;
pub mod transition;
pub mod workers;
