//! A world model, loaded.

use crate::{LatentSpace, transition::LoadedTransition};
use wm_motion::actions::ActionEncoding;

/// A loaded world model: the transition model, and what messages and reports say of it.
#[derive(Clone, Debug)]
pub struct WorldModel {
    /// By which it was opened: `tiny`, or a folder.
    pub name: String,
    /// The transition model.
    pub transition: LoadedTransition,
    /// Lower-case hex SHA-256 of its weights and of all that says how they are used: configuration, action encoding,
    /// latent space.
    pub hash: String,
    /// The space of the latents that it was trained on.
    pub space: LatentSpace,
    /// How physical actions become its actions.
    pub encoding: ActionEncoding,
}
