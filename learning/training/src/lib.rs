//! Training of a world model from bags.
//!
//! `wm_dataset` prepares recordings and encodes them once. A training ([`autoencoder`], [`encoder`], [`adapter`],
//! [`transition`], [`idm`], [`probe`], [`subgoals`], [`distance`]) is a [`run::Task`] with a recipe; [`run`] steps, saves and resumes it.
//! [`model`] trains all parts of a model.
//!
//! Models and inference are in `wm_model`; data come from `wm_sim` and `wm_import`.

pub mod adapter;
mod arguments;
pub mod autoencoder;
pub mod distance;
pub mod distill;
pub mod encoder;
#[cfg(test)]
mod fixture;
mod fresh_weights;
mod gradient_tree;
mod hindsight;
pub mod idm;
pub mod model;
pub mod model_card;
mod model_folder;
mod network_variables;
mod optimiser;
pub mod probe;
mod processes;
mod recipe;
pub mod round;
pub mod run;
pub mod stopped;
pub mod subgoals;
mod trained_weights;
pub mod transition;
mod workers;
