//! The executor's settings.

use std::time::Duration;

use super::{
    Begin, Bounds, Camera, ClockWatch, Deadman, EmergencyStop, Joints, Layout, Limits,
    VetoSettings, Workspace,
};

/// The executor's settings.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The layout of motions in actions.
    pub layout: Layout,
    /// The frame that actions and poses must have; empty: any.
    pub base_frame: String,
    /// Time from one command to the next.
    pub period: Duration,
    /// Bounds of a single action.
    pub bounds: Bounds,
    /// Limits of velocity and acceleration.
    pub limits: Limits,
    /// How long after its reception an offer may be executed.
    pub max_age: Duration,
    /// When an offer begins.
    pub begin: Begin,
    /// How far in the future an offer may begin.
    pub max_lead: Duration,
    /// Time within which the arm comes to rest when there is nothing to execute.
    pub stop_within: Duration,
    /// How long zeros are sent after a motion.
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
