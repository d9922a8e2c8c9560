//! What is computed of frames before the rollout that begins with them.

use super::{Rollout, window::Window};

/// What was computed of the first frames of a rollout that is still to come: the newest of its context may not have been
/// observed yet when the others are known.
#[derive(Clone, Debug)]
pub struct Prepared(Window);

impl Rollout<'_> {
    /// What has been computed of the context so far.
    pub fn prepared(&self) -> Prepared {
        Prepared(self.window.clone())
    }

    /// Takes over what this model has computed of the same first frames under the same actions, and returns of how many
    /// frames that is. The others are computed as ever, and the predictions are the same bit for bit.
    pub fn take_over(&mut self, prepared: &Prepared) -> usize {
        let Prepared(window) = prepared;
        self.window.take_over(window, self.model)
    }
}
