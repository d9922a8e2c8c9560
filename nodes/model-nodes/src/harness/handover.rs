//! The change to a model of another latent space, without a gap.
//!
//! A node works with its model until the first latent of the new space arrives. Latents of another space that arrive
//! while the new model is loaded, or at the moment of the change, are kept for it.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::{sync::Notify, time::Instant};
use wm_model::LatentSpace;
use wm_msgs::wm_msgs::{Latent, Prediction};
use wm_ros::Received;

/// Most messages that are kept; of more, the newest.
const MOST_KEPT: usize = 32;
/// Longest wait of a loaded model for the first latent of its space.
const LONGEST_WAIT: Duration = Duration::from_secs(10);
/// Wait of a node that makes latents: the other nodes load more weights.
const HEAD_START: Duration = Duration::from_secs(2);

/// When a node changes to a loaded model.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum ChangeTime {
    /// At once.
    Now,
    /// At the first latent of the model's space, or at the time if none arrives.
    FirstLatent(LatentSpace, Instant),
    /// At the time.
    At(Instant),
}

impl ChangeTime {
    /// For a change from a model of the space `present` to one of the space `new` that is loaded `now`. `None` stands
    /// for a model without latents.
    pub fn of(
        present: Option<&LatentSpace>,
        new: Option<&LatentSpace>,
        makes_latents: bool,
        now: Instant,
    ) -> Self {
        match (present, new) {
            (Some(present), Some(new)) if present != new => match makes_latents {
                true => Self::At(now + HEAD_START),
                false => Self::FirstLatent(new.clone(), now + LONGEST_WAIT),
            },
            _ => Self::Now,
        }
    }
}

/// A message of another latent space than the node's model.
#[derive(Clone, Debug)]
pub(crate) enum KeptMessage {
    /// Of a camera frame.
    Latent(Received<Arc<Latent>>),
    /// Of a predicted frame.
    Prediction(Received<Arc<Prediction>>),
}

impl KeptMessage {
    fn is_of(&self, space: &LatentSpace) -> bool {
        match self {
            Self::Latent(received) => is_of(&received.message, space),
            Self::Prediction(received) => is_of(&received.message.latent, space),
        }
    }
}

/// Whether a latent is of a space.
pub(crate) fn is_of(latent: &Latent, space: &LatentSpace) -> bool {
    (&latent.space.name, &latent.space.hash) == (&space.name, &space.hash)
}

/// What the message loop of a node and its changes of the model share.
#[derive(Clone, Debug, Default)]
pub struct Handover {
    state: Arc<Mutex<State>>,
    arrived: Arc<Notify>,
}

#[derive(Debug, Default)]
struct State {
    is_changing: bool,
    kept: VecDeque<KeptMessage>,
    /// Kept messages of the model that the node has changed to.
    ready: VecDeque<KeptMessage>,
}

impl Handover {
    /// A model is being loaded.
    pub(super) fn begin(&self) {
        self.state().is_changing = true;
    }

    /// Keeps a message for a coming model. Returns false if no change is in progress, or if an older message is lost.
    pub(crate) fn keep(&self, message: KeptMessage) -> bool {
        let mut state = self.state();
        if !state.is_changing {
            return false;
        }
        let is_full = state.kept.len() >= MOST_KEPT;
        if is_full {
            state.kept.pop_front();
        }
        state.kept.push_back(message);
        self.arrived.notify_one();
        !is_full
    }

    /// Waits until a node has to change to a model; returns false if no latent of its space arrived. Cancel safe.
    pub(super) async fn wait(&self, time: &ChangeTime) -> bool {
        let (space, until) = match time {
            ChangeTime::Now => return true,
            ChangeTime::At(until) => {
                tokio::time::sleep_until(*until).await;
                return true;
            }
            ChangeTime::FirstLatent(space, until) => (space, until),
        };
        let first = async {
            while !self.state().kept.iter().any(|kept| kept.is_of(space)) {
                self.arrived.notified().await;
            }
        };
        tokio::time::timeout_at(*until, first).await.is_ok()
    }

    /// The node works with a model of this space. Kept messages of the space are delivered; the others are dropped
    /// unless another model `is_coming`. Returns how many are dropped.
    pub(super) fn end(&self, space: Option<&LatentSpace>, is_coming: bool) -> u64 {
        let mut state = self.state();
        let kept = std::mem::take(&mut state.kept);
        let is_own = |kept: &KeptMessage| space.is_some_and(|space| kept.is_of(space));
        let (own, others): (VecDeque<_>, VecDeque<_>) = kept.into_iter().partition(is_own);
        state.ready.extend(own);
        state.is_changing = is_coming;
        if is_coming {
            state.kept = others;
            return 0;
        }
        // At most `MOST_KEPT`.
        others.len() as u64
    }

    /// Forgets all messages.
    pub(super) fn clear(&self) {
        *self.state() = State::default();
    }

    /// The next kept latent of the present model.
    pub(super) fn latent(&self) -> Option<Received<Arc<Latent>>> {
        match self.state().ready.pop_front() {
            Some(KeptMessage::Latent(received)) => Some(received),
            _ => None,
        }
    }

    /// The next kept prediction of the present model.
    pub(crate) fn prediction(&self) -> Option<Received<Arc<Prediction>>> {
        match self.state().ready.pop_front() {
            Some(KeptMessage::Prediction(received)) => Some(received),
            _ => None,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests;
