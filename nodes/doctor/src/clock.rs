//! The system's clock.

use crate::{Finding, Survey};
use wm_ros::Reach;

const CHECK: &str = "clock";
/// A larger step against the monotonic clock means that the clock was set \[s\]; slewing moves it by 0.5 ms per second.
const SET_S: f64 = 0.05;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SystemClock {
    /// Whether a time server keeps it synchronised; `None` if the kernel does not report it.
    pub synchronised: Option<bool>,
}

impl SystemClock {
    pub(crate) fn look() -> Self {
        // SAFETY: `timex` has only integers, for which zeros are valid; `modes` 0 reads without setting, which needs no
        // right.
        let mut timex: libc::timex = unsafe { std::mem::zeroed() };
        // SAFETY: the pointer is to our own `timex`, which the kernel fills.
        let state = unsafe { libc::adjtimex(&raw mut timex) };
        Self {
            synchronised: (state >= 0).then_some(timex.status & libc::STA_UNSYNC == 0),
        }
    }
}

pub(crate) fn check(clock: &SystemClock, reach: &Reach, survey: &Survey) -> Vec<Finding> {
    let mut findings = Vec::new();
    let is_alone = matches!(reach, Reach::Localhost | Reach::Process);
    findings.push(match (clock.synchronised, is_alone) {
        (Some(true), _) => Finding::ok(CHECK, "synchronised with a time server"),
        (_, true) => Finding::ok(CHECK, "all nodes share this machine's clock"),
        (_, false) => Finding::warning(CHECK, "not synchronised with a time server, as far as the kernel knows")
            .because("frames and actions of several machines are matched by their stamps; stamps 10 s ahead are refused")
            .fix("sudo timedatectl set-ntp true, or chrony on all machines"),
    });
    let moved = survey
        .streams()
        .filter_map(|stream| stream.timeline.clock_moved_s());
    let most = moved.max_by(|a, b| a.abs().total_cmp(&b.abs()));
    if let Some(moved_s) = most.filter(|moved_s| moved_s.abs() > SET_S) {
        findings.push(
            Finding::warning(
                CHECK,
                format!("this machine's clock was set by {moved_s:+.2} s while listening"),
            )
            .because("a clock that is set back by more than 0.5 s ends the nodes")
            .fix(
                "let chrony or systemd-timesyncd slew the clock, and set it before the nodes start",
            ),
        );
    }
    if survey.clock_ns.is_some() {
        findings.push(
            Finding::note(CHECK, "/clock has a publisher")
                .because("stamps of a simulator or a bag are in its time; nodes that do not follow /clock refuse them or measure wrong latencies")
                .fix("-p use_sim_time:=true on every node; if the stamps are in real time, stop the publisher of /clock"),
        );
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Actions, Level, Stream, timeline::regular};

    fn levels(synchronised: Option<bool>, reach: Reach, survey: &Survey) -> Vec<Level> {
        let found = check(&SystemClock { synchronised }, &reach, survey);
        found.iter().map(|finding| finding.level).collect()
    }

    #[test]
    fn only_several_machines_need_a_common_clock() {
        let survey = Survey::default();
        assert_eq!(levels(Some(false), Reach::Localhost, &survey), [Level::Ok]);
        assert_eq!(
            levels(Some(false), Reach::Subnet, &survey),
            [Level::Warning]
        );
        assert_eq!(levels(None, Reach::Subnet, &survey), [Level::Warning]);
        assert_eq!(levels(Some(true), Reach::Subnet, &survey), [Level::Ok]);
    }

    #[test]
    fn set_clocks_and_simulated_clocks_are_reported() {
        let mut timeline = regular(9, 100, 0);
        timeline.0[8].received_ns -= 3_000_000_000;
        let stream = Stream {
            timeline,
            ..Stream::default()
        };
        let mut survey = Survey::default();
        survey.actions.insert(
            "/a".into(),
            Actions {
                stream,
                ..Actions::default()
            },
        );
        assert_eq!(
            levels(Some(true), Reach::Localhost, &survey),
            [Level::Ok, Level::Warning]
        );
        survey.clock_ns = Some((5, 7));
        assert_eq!(
            levels(Some(true), Reach::Localhost, &survey)[2],
            Level::Note
        );
    }
}
