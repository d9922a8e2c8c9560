//! What to reach.

mod error;
mod reader;

pub use error::GoalError;
pub use reader::GoalReader;

use std::sync::Arc;

use wm_msgs::builtin_interfaces::Time;
use wm_zoo::success_probe::Instruction;

/// Goals that are reached one after the other, at most.
const MOST_LATENTS: usize = 256;

/// What to reach: latents, one after the other, or words.
#[derive(Clone, Debug)]
pub struct Goal {
    /// Of its message.
    pub stamp: Time,
    /// Normalised latents in their order, each row-major, channels last. None where words alone say what to reach.
    pub latents: Vec<Arc<[f32]>>,
    /// When each is to be reached, since the goal was set \[ns\], ascending; empty: each when the one before is reached.
    pub times_ns: Vec<i64>,
    /// How much each cell of the grid counts, row-major; `None`: all the same.
    pub mask: Option<Arc<[f32]>>,
    /// The task in words, as the success probe reads it.
    pub instruction: Option<Arc<Instruction>>,
}

impl Goal {
    /// The goal to be where `values` are, a normalised latent.
    pub fn of_latent(stamp: Time, values: Arc<[f32]>) -> Self {
        Self {
            stamp,
            latents: vec![values],
            times_ns: Vec::new(),
            mask: None,
            instruction: None,
        }
    }
}
