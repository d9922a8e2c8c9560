//! A camera whose clock differs from the arm's.

use std::fmt;

/// How long an arm that stands still may publish nothing \[ns\].
const SILENT_NS: i64 = 60_000_000_000;

/// The clock of the camera has jumped, and that of the actions has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraStep {
    /// Forwards, or backwards if it is negative \[ns\].
    by_ns: i64,
}

impl fmt::Display for CameraStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let direction = if self.by_ns < 0 { "back" } else { "forward" };
        let seconds = self.by_ns.unsigned_abs() as f64 / 1e9;
        write!(
            f,
            "the camera's clock stepped {direction} by {seconds:.1} s, and that of the actions did not: the camera's driver \
             has a clock of its own that was set or has wrapped; have it stamp by the system's clock"
        )
    }
}

/// Whether frames and actions are stamped by one clock. After a step of the camera's clock alone, the stamps of actions are
/// moved by as much, so that frames and actions still match.
#[derive(Clone, Debug, Default)]
pub(super) struct CameraClock {
    /// Stamp of the newest action, in the camera's time \[ns\].
    action_ns: Option<i64>,
    /// From the actions' time to the camera's \[ns\].
    shift_ns: i64,
}

impl CameraClock {
    /// Takes the stamp of an action while the newest frame is of `newest_ns`; gives it in the camera's time. An action
    /// within `tolerance_ns` of the frame shows that both clocks agree again.
    pub fn action(&mut self, stamp_ns: i64, newest_ns: Option<i64>, tolerance_ns: i64) -> i64 {
        if newest_ns.is_some_and(|newest_ns| is_near(stamp_ns, newest_ns, tolerance_ns)) {
            self.shift_ns = 0;
        }
        let stamp_ns = self.in_camera_time(stamp_ns);
        self.action_ns = Some(stamp_ns);
        stamp_ns
    }

    /// A stamp of the actions' time in the camera's.
    pub fn in_camera_time(&self, stamp_ns: i64) -> i64 {
        stamp_ns.saturating_add(self.shift_ns)
    }

    /// Handles a jump of the frames from `from_ns` to `to_ns`, `by_ns` more than the time that has passed.
    pub fn jumped(&mut self, from_ns: i64, to_ns: i64, by_ns: i64, tolerance_ns: i64) {
        let Some(action_ns) = self.action_ns else {
            return;
        };
        let raw_ns = action_ns.saturating_sub(self.shift_ns);
        let lead_ns = action_ns.saturating_sub(from_ns);
        let did_agree = (-SILENT_NS..=tolerance_ns).contains(&lead_ns);
        self.shift_ns = match is_near(raw_ns, to_ns, tolerance_ns) {
            true => 0,
            false if did_agree => self.shift_ns.saturating_add(by_ns),
            false => 0,
        };
        self.action_ns = Some(self.in_camera_time(raw_ns));
    }

    /// The step of the camera's clock, for as long as the clocks do not agree.
    pub fn step(&self) -> Option<CameraStep> {
        (self.shift_ns != 0).then_some(CameraStep {
            by_ns: self.shift_ns,
        })
    }

    /// Frames of another camera, or time that has jumped for all.
    pub fn restart(&mut self) {
        *self = Self::default();
    }
}

fn is_near(one_ns: i64, other_ns: i64, tolerance_ns: i64) -> bool {
    one_ns.saturating_sub(other_ns).saturating_abs() <= tolerance_ns
}
