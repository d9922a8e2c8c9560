//! The state of the camera that offers depend on.

use std::time::{Duration, Instant};

use wm_msgs::wm_msgs::CameraState;

use super::{Hold, Moment, Offer, Refusal, refusal::stamp_of};

/// The encoder's reports about the camera. Without an encoder none is expected.
#[derive(Clone, Debug)]
pub struct Camera {
    timeout: Duration,
    /// When the last report came, and the reason of the stop that it reports.
    last: Option<(Instant, Option<String>)>,
    /// Capture time of the first frame after the last freeze \[ns\].
    thawed_ns: Option<i64>,
}

impl Camera {
    /// A camera whose reports must arrive at least every `timeout`, after the first one.
    pub fn new(timeout: Duration) -> Self {
        Self {
            timeout,
            last: None,
            thawed_ns: None,
        }
    }

    /// Takes a report.
    ///
    /// # Errors
    /// [`Refusal::Stamp`]: its stamp is malformed. The report is dropped, unless it reports a stop.
    pub(super) fn report(&mut self, state: &CameraState, received: Moment) -> Result<(), Refusal> {
        let stamp_ns = stamp_of("camera_state", state.header.stamp);
        if state.frozen {
            let reason = match state.reason.as_str() {
                "" => "its frames do not change",
                reason => reason,
            };
            self.last = Some((received.at, Some(reason.to_owned())));
            return stamp_ns.map(drop);
        }
        let stamp_ns = stamp_ns?;
        if self.check(received).is_err() {
            self.thawed_ns = Some(stamp_ns);
        }
        self.last = Some((received.at, None));
        Ok(())
    }

    /// Checks that the camera runs.
    ///
    /// # Errors
    /// [`Hold::CameraFrozen`] or [`Hold::CameraSilent`].
    pub(super) fn check(&self, now: Moment) -> Result<(), Hold> {
        match &self.last {
            None => Ok(()),
            Some((_, Some(reason))) => Err(Hold::CameraFrozen {
                reason: reason.clone(),
            }),
            Some((at, None)) if now.at.saturating_duration_since(*at) > self.timeout => {
                Err(Hold::CameraSilent {
                    timeout_s: self.timeout.as_secs_f64(),
                })
            }
            Some((_, None)) => Ok(()),
        }
    }

    /// Checks that an offer was made from a frame that is newer than the last freeze.
    ///
    /// # Errors
    /// [`Refusal::FrozenFrame`].
    pub(super) fn expect_seen(&self, offer: &Offer) -> Result<(), Refusal> {
        match self.thawed_ns {
            Some(thawed_ns) if offer.seen_ns() < thawed_ns => Err(Refusal::FrozenFrame {
                before_s: thawed_ns.saturating_sub(offer.seen_ns()) as f64 / 1e9,
            }),
            _ => Ok(()),
        }
    }

    /// Drops the stamps from before the node's clock was set back.
    pub(super) fn forget_stamps(&mut self) {
        self.thawed_ns = None;
    }

    /// No longer expects reports of an encoder that has ended. A frozen camera stays frozen until the encoder reports
    /// otherwise.
    pub(super) fn reset(&mut self) {
        if self
            .last
            .as_ref()
            .is_some_and(|(_, reason)| reason.is_none())
        {
            self.last = None;
        }
    }
}
