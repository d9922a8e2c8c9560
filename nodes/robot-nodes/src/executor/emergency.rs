//! The topic of the emergency stop: the publishers that press it, and whether they are connected.

use std::collections::BTreeSet;

use wm_ros::PublisherId;

use super::{ArmError, Cause};

/// The publishers of the topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StopSources {
    /// The publishers that are connected.
    pub connected: BTreeSet<PublisherId>,
    /// Publishers that are not connected, each with the reason.
    pub mismatches: Vec<String>,
}

/// The topic of the emergency stop.
#[derive(Clone, Debug)]
pub struct EmergencyStop {
    is_required: bool,
    /// Publishers whose newest message is true: one of them does not release what another presses.
    pressed: BTreeSet<PublisherId>,
    /// Those of them that have gone, and cannot release it themselves.
    gone: BTreeSet<PublisherId>,
    sources: StopSources,
}

impl EmergencyStop {
    /// The topic; `is_required`: at least one publisher must be connected.
    pub fn new(is_required: bool) -> Self {
        Self {
            is_required,
            pressed: BTreeSet::new(),
            gone: BTreeSet::new(),
            sources: StopSources::default(),
        }
    }

    /// Takes the newest message of a publisher. Any publisher can release the stop of one that has gone.
    pub(super) fn press(&mut self, publisher: PublisherId, is_pressed: bool) {
        self.gone.remove(&publisher);
        if is_pressed {
            self.pressed.insert(publisher);
            return;
        }
        self.pressed.remove(&publisher);
        let gone = std::mem::take(&mut self.gone);
        self.pressed.retain(|pressed| !gone.contains(pressed));
    }

    /// Takes the publishers; returns the reason if an armed arm must stop.
    pub(super) fn connect(&mut self, sources: StopSources) -> Option<Cause> {
        let before = std::mem::replace(&mut self.sources, sources);
        let gone = before.connected.difference(&self.sources.connected);
        self.gone
            .extend(gone.filter(|gone| self.pressed.contains(gone)));
        if let Some(text) = self.sources.mismatches.first() {
            return Some(Cause::StopMismatch(text.clone()));
        }
        let is_lost = !before.connected.is_subset(&self.sources.connected);
        is_lost.then_some(Cause::StopLost)
    }

    /// Checks that the topic can stop the arm.
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

    /// Checks that no publisher presses it.
    ///
    /// # Errors
    /// [`ArmError::Pressed`].
    pub(super) fn expect_released(&self) -> Result<(), ArmError> {
        match self.pressed.is_empty() {
            true => Ok(()),
            false => Err(ArmError::Pressed),
        }
    }
}
