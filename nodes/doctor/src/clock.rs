//! The system's clock.

use crate::{Finding, Heard};
use wm_ros::Reach;

/// This check.
const CHECK: &str = "clock";
/// A clock that moves this far against one that never jumps has been set \[s\]; slewing moves it by 0.5 ms a second.
const SET_S: f64 = 0.05;

/// The system's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SystemClock {
    /// Whether something keeps it in step with a time server; none where the kernel does not say.
    pub synchronised: Option<bool>,
}

impl SystemClock {
    pub fn look() -> Self {
        // SAFETY: `timex` is plain integers, for which zeros are valid; `modes` 0 asks and sets nothing, which needs no
        // right.
        let mut timex: libc::timex = unsafe { std::mem::zeroed() };
        // SAFETY: a pointer to a `timex` of our own, which the kernel fills.
        let state = unsafe { libc::adjtimex(&raw mut timex) };
        Self {
            synchronised: (state >= 0).then_some(timex.status & libc::STA_UNSYNC == 0),
        }
    }
}

/// What is to be said of it.
pub(crate) fn check(clock: &SystemClock, reach: &Reach, heard: &Heard) -> Vec<Finding> {
    let mut findings = Vec::new();
    let is_alone = matches!(reach, Reach::Localhost | Reach::Process);
    findings.push(match (clock.synchronised, is_alone) {
        (Some(true), _) => Finding::ok(CHECK, "in step with a time server"),
        (_, true) => Finding::ok(CHECK, "all nodes share this machine's clock"),
        (_, false) => Finding::warning(CHECK, "not in step with a time server, as far as the kernel knows")
            .because("frames and actions of several machines are matched by their stamps; what is stamped 10 s ahead is refused")
            .fix("sudo timedatectl set-ntp true, or chrony on all machines"),
    });
    let moved = heard
        .streams()
        .filter_map(|stream| stream.timeline.clock_moved_s());
    let most = moved.max_by(|a, b| a.abs().total_cmp(&b.abs()));
    if let Some(moved_s) = most.filter(|moved_s| moved_s.abs() > SET_S) {
        findings.push(
            Finding::warning(
                CHECK,
                format!("this machine's clock was set by {moved_s:+.2} s while it was listened to"),
            )
            .because("a clock that is set back by more than 0.5 s ends the nodes")
            .fix(
                "let chrony or systemd-timesyncd slew the clock, and set it before the nodes start",
            ),
        );
    }
    if heard.clock_ns.is_some() {
        findings.push(
            Finding::note(CHECK, "somebody publishes /clock")
                .because("stamps of a simulator or a bag are in its time; nodes that do not follow it refuse them or measure wrong latencies")
                .fix("-p use_sim_time:=true on every node, or none, where the stamps are in real time"),
        );
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Actions, Level, Stream, timeline::regular};

    fn levels(synchronised: Option<bool>, reach: Reach, heard: &Heard) -> Vec<Level> {
        let found = check(&SystemClock { synchronised }, &reach, heard);
        found.iter().map(|finding| finding.level).collect()
    }

    #[test]
    fn only_several_machines_need_a_common_clock() {
        let heard = Heard::default();
        assert_eq!(levels(Some(false), Reach::Localhost, &heard), [Level::Ok]);
        assert_eq!(levels(Some(false), Reach::Subnet, &heard), [Level::Warning]);
        assert_eq!(levels(None, Reach::Subnet, &heard), [Level::Warning]);
        assert_eq!(levels(Some(true), Reach::Subnet, &heard), [Level::Ok]);
    }

    #[test]
    fn a_clock_that_was_set_is_seen_and_so_is_that_of_a_simulator() {
        let mut timeline = regular(9, 100, 0);
        timeline.0[8].received_ns -= 3_000_000_000;
        let stream = Stream {
            timeline,
            ..Stream::default()
        };
        let mut heard = Heard::default();
        heard.actions.insert(
            "/a".into(),
            Actions {
                stream,
                ..Actions::default()
            },
        );
        assert_eq!(
            levels(Some(true), Reach::Localhost, &heard),
            [Level::Ok, Level::Warning]
        );
        heard.clock_ns = Some((5, 7));
        assert_eq!(levels(Some(true), Reach::Localhost, &heard)[2], Level::Note);
    }
}
