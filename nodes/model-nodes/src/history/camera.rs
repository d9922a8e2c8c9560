//! The one camera that a history is of.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use wm_ros::PublisherId;

use super::{HistoryError, Reception};

/// The camera and the publisher that a history's frames come from. Latents of two cameras in one context would be
/// neither's picture, so all others are refused for as long as this one goes on.
#[derive(Clone, Debug)]
pub(super) struct Camera {
    frame_id: Arc<str>,
    publisher: PublisherId,
    last: Instant,
}

impl Camera {
    pub fn new(frame_id: &str, reception: &Reception) -> Self {
        Self {
            frame_id: frame_id.into(),
            publisher: reception.publisher,
            last: reception.at,
        }
    }

    /// Whether a frame is this camera's. Another one may take over once this one has been silent for longer than
    /// `silence`.
    ///
    /// # Errors
    /// [`HistoryError::WrongFrame`] where this camera goes on.
    pub fn admit(
        &mut self,
        frame_id: &str,
        reception: &Reception,
        silence: Duration,
    ) -> Result<Admission, HistoryError> {
        if *self.frame_id == *frame_id && self.publisher == reception.publisher {
            self.last = reception.at;
            return Ok(Admission::Same);
        }
        if reception.at.saturating_duration_since(self.last) > silence {
            *self = Self::new(frame_id, reception);
            return Ok(Admission::TakenOver);
        }
        Err(HistoryError::WrongFrame {
            frame_id: frame_id.into(),
            expected: self.frame_id.to_string(),
            is_other_publisher: self.publisher != reception.publisher,
        })
    }
}

/// Whose a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// The camera's.
    Same,
    /// Another one's, which takes its place.
    TakenOver,
}
