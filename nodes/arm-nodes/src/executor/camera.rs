//! Whether the camera that offers depend on shows the present.

use std::time::{Duration, Instant};

use wm_msgs::wm_msgs::CameraState;

use super::{Hold, Moment, Offer, Refusal, refusal::stamp_of};

/// What the encoder reports about the camera. Without an encoder there is no report, and nothing to wait for.
#[derive(Clone, Debug)]
pub struct Camera {
    timeout: Duration,
    last: Option<(Instant, Option<String>)>,
    /// Capture time of the first frame after the last freeze \[ns\].
    thawed_ns: Option<i64>,
}

impl Camera {
    /// A camera whose reports have to come at least every `timeout`, once one has come.
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
    /// [`Refusal::Stamp`]: its stamp is malformed. The report is dropped.
    pub(super) fn report(&mut self, state: &CameraState, received: Moment) -> Result<(), Refusal> {
        let stamp_ns = stamp_of("camera_state", state.header.stamp)?;
        let was_stopped = self.check(received).is_err();
        if was_stopped && !state.frozen {
            self.thawed_ns = Some(stamp_ns);
        }
        let reason = state.frozen.then(|| match state.reason.as_str() {
            "" => "its frames do not change".to_owned(),
            reason => reason.to_owned(),
        });
        self.last = Some((received.at, reason));
        Ok(())
    }

    /// Whether the camera runs.
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

    /// Whether an offer was made from a frame that is newer than the last freeze.
    ///
    /// # Errors
    /// [`Refusal::FrozenFrame`].
    pub(super) fn expect_seen(&self, offer: &Offer) -> Result<(), Refusal> {
        match self.thawed_ns {
            Some(thawed_ns) if offer.seen_ns < thawed_ns => Err(Refusal::FrozenFrame {
                before_s: thawed_ns.saturating_sub(offer.seen_ns) as f64 / 1e9,
            }),
            _ => Ok(()),
        }
    }

    /// The node's clock was set back: stamps of before no longer compare.
    pub(super) fn forget_stamps(&mut self) {
        self.thawed_ns = None;
    }

    /// A person says that things are in order: an encoder that has ended is no longer waited for. A camera that was
    /// frozen stays so until the encoder reports otherwise.
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
