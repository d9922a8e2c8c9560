//! The model's state of one episode.

use std::{collections::VecDeque, sync::Arc};

/// The latents that an episode's next step is predicted from. Bounded by the model's window.
#[derive(Clone, Debug)]
pub(super) struct Episode {
    /// Oldest first; row-major, channels last.
    frames: VecDeque<Arc<[f32]>>,
    /// Model actions, number i from frame i to the next.
    actions: VecDeque<Vec<f32>>,
    /// Frames that the model can see of the past.
    capacity: usize,
    seed: u64,
    steps: usize,
}

impl Episode {
    /// An episode that begins with `frames` (at least one) and the model actions between them.
    pub fn new(
        frames: Vec<Arc<[f32]>>,
        actions: Vec<Vec<f32>>,
        capacity: usize,
        seed: u64,
    ) -> Self {
        let mut episode = Self {
            frames: frames.into(),
            actions: actions.into(),
            capacity: capacity.max(1),
            seed,
            steps: 0,
        };
        episode.trim();
        episode
    }

    pub fn frames(&self) -> impl ExactSizeIterator<Item = &Arc<[f32]>> {
        self.frames.iter()
    }

    pub fn actions(&self) -> impl Iterator<Item = &Vec<f32>> {
        self.actions.iter()
    }

    /// The newest frame; never empty by construction.
    pub fn newest(&self) -> Option<&Arc<[f32]>> {
        self.frames.back()
    }

    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Steps taken.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Records the latent after `action`.
    pub fn push(&mut self, action: Vec<f32>, frame: Arc<[f32]>) {
        self.actions.push_back(action);
        self.frames.push_back(frame);
        self.steps += 1;
        self.trim();
    }

    fn trim(&mut self) {
        while self.frames.len() > self.capacity {
            self.frames.pop_front();
            self.actions.pop_front();
        }
    }
}
