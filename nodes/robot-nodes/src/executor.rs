//! The executor node: chunks and plans in, commands for an arm out.
//!
//! [`ExecutorStep`] is the node's whole behaviour without DDS and without a clock. It takes an offer (a chunk or a plan)
//! only if it passes every check ([`Refusal`]). Each [`ExecutorStep::tick`] gives the command ([`Output`]): the motion of
//! the newest offer in the next command period, within limits of velocity and acceleration ([`Limits`]), of the workspace
//! ([`Workspace`]) or the joints ([`Joints`]), and of the deadman switch ([`Deadman`]). An end effector moves, or joints,
//! by the [`Layout`] of the actions; the step knows only axes ([`Rates`]).
//!
//! Promises, each with a test:
//! - Before the node is armed, nothing is sent on the command topics; after an emergency stop, only zeros are.
//! - Commanded velocity and acceleration never exceed their limits; the emergency stop alone is a step to zero.
//! - If an input is missing (the next chunk, the pose, the deadman, the clock, the camera), the arm stands still within
//!   `stop_within`.
//! - An offer is executed for at most `max_age` after its reception, by the node's clock and by real time. With
//!   `command_clock` ros, real time counts once the node's clock stands still.
//!
//! It is no safety function: it runs on an ordinary computer and network. The arm's controller has to stop by itself if
//! commands fail to come.

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
pub use node::NODE;
pub use offer::{Begin, Offer, Source};
pub use rates::Rates;
pub use refusal::Refusal;
pub use settings::Settings;
pub use status::{Counts, State, Status};
pub use step::{ArmError, Command, ExecutorStep, Output, Taken, Tick};
pub use velocity::Velocity;
pub use veto::{Veto, VetoSettings};
pub use workspace::{PoseError, Workspace};
