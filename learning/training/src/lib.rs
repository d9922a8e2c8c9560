//! Training of a world model from bags.
//!
//! `wm_dataset` turns recordings into episodes and encodes them once. A training ([`autoencoder`], [`encoder`],
//! [`adapter`], [`transition`], [`idm`], [`probe`]) is a [`run::Task`] with a [`recipe`]; [`run`] steps it, saves it and
//! takes it up again. [`model`] trains all parts of a model.
//!
//! Not here: the models themselves and inference (`wm_model`), making data (`wm_sim`, `wm_import`).

pub mod adapter;
pub mod arguments;
pub mod autoencoder;
pub mod distill;
pub mod encoder;
#[cfg(test)]
mod fixture;
pub mod fresh_weights;
pub mod idm;
pub mod model;
pub mod model_card;
pub mod model_folder;
pub mod optimiser;
pub mod probe;
pub mod recipe;
pub mod run;
pub mod stopped;
mod trained_weights;
pub mod transition;
pub mod workers;
