//! The executor node: chunks and plans in, commands for an arm out.
//!
//! [`ExecutorStep`] is the node's whole behaviour without DDS and without a clock. It takes an offer (a chunk or a plan)
//! only if it passes every check ([`Refusal`]), and at each [`ExecutorStep::tick`] says what to send ([`Output`]): the
//! motion that the newest offer tells for the next command period, within limits of velocity and acceleration
//! ([`Limits`]), of the workspace ([`Workspace`]) or the joints ([`Joints`]), and of the deadman switch ([`Deadman`]).
//! What moves is an end effector or joints, by the [`Layout`] of the actions; the step knows only axes ([`Rates`]).
//!
//! Promises, each with a test:
//! - Nothing is sent on the command topics before the node is armed, or after an emergency stop but zeros.
//! - Commanded velocity and acceleration never exceed their limits; the emergency stop alone is a step to zero.
//! - Whatever is missing (the next chunk, the pose, the deadman, the clock, the camera) ends in zero velocity within
//!   `stop_within`.
//! - What is executed is no older than `max_age`, by the node's clock and by the monotonic one.
//!
//! It is no safety function: it runs on an ordinary computer and network. The arm's controller has to stop by itself
//! where commands stay out.

mod beat;
mod bounds;
mod camera;
mod cause;
mod clock_watch;
mod deadman;
mod emergency;
mod joints;
mod lateness;
mod layout;
mod limits;
mod message;
mod moment;
mod node;
mod offer;
mod outlets;
mod parameters;
mod rates;
mod refusal;
mod schedule;
mod settings;
mod status;
mod step;
mod velocity;
mod veto;
mod workspace;

pub use bounds::Bounds;
pub use camera::Camera;
pub use cause::{Cause, Hold};
pub use clock_watch::ClockWatch;
pub use deadman::Deadman;
pub use emergency::{EmergencyStop, StopSources};
pub use joints::{JointError, Joints};
pub use lateness::LateNotice;
pub use layout::{Layout, LayoutError};
pub use limits::{Group, Limits};
pub use moment::Moment;
pub use node::{NODE, body};
pub use offer::{Begin, Offer, Source};
pub use rates::Rates;
pub use refusal::Refusal;
pub use settings::Settings;
pub use status::{Counts, State, Status};
pub use step::{ArmError, Command, ExecutorStep, Output, Taken, Tick};
pub use velocity::Velocity;
pub use veto::{Veto, VetoSettings};
pub use workspace::{PoseError, Workspace};
