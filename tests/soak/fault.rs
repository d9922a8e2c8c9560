//! The injected faults.

use std::{process::Command, time::Duration};

use rustix::process::Signal;

use crate::{
    middle::{Middle, Pictures},
    suite::{Suite, World},
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum Kind {
    /// The same picture with new stamps.
    CameraFrozen,
    /// The same picture with a noise of one grey level and new stamps.
    CameraFrozenNoise,
    /// No pictures.
    CameraSilent,
    /// `/clock` stops.
    ClockStopped,
    /// `/clock` stops, and continues one second earlier.
    ClockBack,
    /// No data between processes.
    Cut,
    KillEncoder,
    KillPlanner,
    KillExecutor,
    /// The planner's process is stopped and continued.
    StopPlanner,
    /// The executor's process is stopped and continued.
    StopExecutor,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// The publisher of the emergency stop disappears.
    EmergencyLost,
}

impl Kind {
    /// How long the arm may be commanded to move after the fault begins: by the parameters' defaults, plus half a
    /// second for a busy machine.
    pub fn limit(self) -> Duration {
        Duration::from_millis(match self {
            // until the encoder has detected it and the arm rests
            Self::CameraFrozen | Self::CameraFrozenNoise => 4_000,
            // camera_timeout and stop_within; or max_age without reports about the camera
            Self::CameraSilent | Self::KillEncoder | Self::KillPlanner | Self::StopPlanner => 2_700,
            // max_age
            Self::ClockStopped | Self::ClockBack => 2_500,
            // commands are invisible; the arm stops after command_timeout and a step
            Self::Cut | Self::KillExecutor | Self::StopExecutor => 1_200,
            Self::EmergencyStop => 500,
            Self::EmergencyLost => 700,
        })
    }

    pub fn name(self) -> String {
        let value = clap::ValueEnum::to_possible_value(&self);
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// What can go wrong here: the network is cut only in a namespace of its own.
pub fn possible() -> Vec<Kind> {
    let mut kinds = <Kind as clap::ValueEnum>::value_variants().to_vec();
    // only a separate namespace has no other interface than loopback
    let devices = std::fs::read_to_string("/proc/self/net/dev").unwrap_or_default();
    let mut names = devices.lines().filter_map(|line| line.split_once(':'));
    let is_own = names.all(|(name, _)| name.trim() == "lo");
    if !is_own {
        println!("soak: no network cuts; run it by unshare -n");
        kinds.retain(|kind| *kind != Kind::Cut);
    }
    kinds
}

fn set_loopback(state: &str) {
    let status = Command::new("ip")
        .args(["link", "set", "lo", state])
        .status()
        .expect("ip");
    assert!(status.success(), "cannot set lo {state}");
}

pub fn begin(kind: Kind, middle: &Middle, world: &World, suite: &mut Suite) {
    match kind {
        Kind::CameraFrozen => middle.show(Pictures::Frozen),
        Kind::CameraFrozenNoise => middle.show(Pictures::FrozenNoise),
        Kind::CameraSilent => middle.show(Pictures::Silent),
        Kind::ClockStopped | Kind::ClockBack => middle.stop_clock(),
        Kind::Cut => set_loopback("down"),
        Kind::KillEncoder => suite.signal("encoder", Signal::KILL),
        Kind::KillPlanner => suite.signal("planner", Signal::KILL),
        Kind::KillExecutor => suite.signal("executor", Signal::KILL),
        Kind::StopPlanner => suite.signal("planner", Signal::STOP),
        Kind::StopExecutor => suite.signal("executor", Signal::STOP),
        Kind::EmergencyStop => world.press(true),
        Kind::EmergencyLost => world.drop_emergency(),
    }
}

pub fn end(kind: Kind, middle: &Middle, world: &World, suite: &mut Suite) {
    match kind {
        Kind::CameraFrozen | Kind::CameraFrozenNoise | Kind::CameraSilent => {
            middle.show(Pictures::Live);
        }
        Kind::ClockStopped => middle.run_clock(Duration::ZERO),
        Kind::ClockBack => middle.run_clock(Duration::from_secs(1)),
        Kind::Cut => set_loopback("up"),
        Kind::StopPlanner => suite.signal("planner", Signal::CONT),
        Kind::StopExecutor => suite.signal("executor", Signal::CONT),
        Kind::EmergencyStop => world.press(false),
        Kind::EmergencyLost => world.make_emergency(),
        Kind::KillEncoder | Kind::KillPlanner | Kind::KillExecutor => {}
    }
}
