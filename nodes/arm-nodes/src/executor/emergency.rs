//! The topic of the emergency stop: what it says, and whether it is connected.

use std::collections::BTreeSet;

use wm_ros::PublisherId;

use super::{ArmError, Cause};

/// Who can stop the arm by the topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopSources {
    /// The publishers that are connected.
    pub connected: BTreeSet<PublisherId>,
    /// Why other publishers of the topic are not, in words.
    pub mismatches: Vec<String>,
}

/// The topic of the emergency stop.
#[derive(Clone, Debug)]
pub struct EmergencyStop {
    is_required: bool,
    is_pressed: bool,
    sources: StopSources,
}

impl EmergencyStop {
    /// A topic that may or may not need a publisher.
    pub fn new(is_required: bool) -> Self {
        Self {
            is_required,
            is_pressed: false,
            sources: StopSources::default(),
        }
    }

    /// Takes the newest message.
    pub(super) fn press(&mut self, is_pressed: bool) {
        self.is_pressed = is_pressed;
    }

    /// Takes who is connected, and gives why an armed arm has to stop.
    pub(super) fn connect(&mut self, sources: StopSources) -> Option<Cause> {
        let before = std::mem::replace(&mut self.sources, sources);
        if let Some(text) = self.sources.mismatches.first() {
            return Some(Cause::StopMismatch(text.clone()));
        }
        let is_lost = !before.connected.is_subset(&self.sources.connected);
        is_lost.then_some(Cause::StopLost)
    }

    /// Whether the arm can be stopped by the topic, as far as that is expected.
    ///
    /// # Errors
    /// [`ArmError`].
    pub(super) fn expect_connected(&self) -> Result<(), ArmError> {
        match self.sources.mismatches.first() {
            Some(text) => Err(ArmError::StopMismatch(text.clone())),
            None if self.is_required && self.sources.connected.is_empty() => Err(ArmError::NoStop),
            None => Ok(()),
        }
    }

    /// Whether the topic is released.
    ///
    /// # Errors
    /// [`ArmError::Pressed`].
    pub(super) fn expect_released(&self) -> Result<(), ArmError> {
        match self.is_pressed {
            true => Err(ArmError::Pressed),
            false => Ok(()),
        }
    }
}
