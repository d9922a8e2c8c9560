//! The executor's settings.

use std::time::Duration;

use super::{
    Begin, Bounds, Camera, ClockWatch, Deadman, EmergencyStop, Joints, Layout, Limits,
    VetoSettings, Workspace,
};

/// The executor's settings.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where motions stand in actions.
    pub layout: Layout,
    /// The frame that actions and poses must have; empty: any.
    pub base_frame: String,
    /// Time from one command to the next.
    pub period: Duration,
    /// Bounds of a single action.
    pub bounds: Bounds,
    /// How fast the arm may move.
    pub limits: Limits,
    /// For how long after its reception an offer is executed.
    pub max_age: Duration,
    /// When an offer begins.
    pub begin: Begin,
    /// How far in the future an offer may begin.
    pub max_lead: Duration,
    /// Time within which the arm stands still once there is nothing to execute.
    pub stop_within: Duration,
    /// For how long zeros are sent after a motion.
    pub zero_for: Duration,
    /// Whether offers are tried out while it is not armed.
    pub dry_run: bool,
    /// The box that the end effector has to stay in.
    pub workspace: Option<Workspace>,
    /// The joints, if the actions are of joints.
    pub joints: Option<Joints>,
    /// The switch that has to be held.
    pub deadman: Option<Deadman>,
    /// The watchdog for the node's clock.
    pub clock: ClockWatch,
    /// The camera that offers depend on.
    pub camera: Camera,
    /// The topic of the emergency stop.
    pub emergency: EmergencyStop,
    /// Rules about predictions.
    pub veto: VetoSettings,
}
