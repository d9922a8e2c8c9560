//! Commands and status as messages.

use wm_msgs::{
    builtin_interfaces::{Duration, Time},
    geometry_msgs::{Twist, TwistStamped, Vector3},
    std_msgs::{Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout},
    trajectory_msgs::{JointTrajectory, JointTrajectoryPoint},
    visualization_msgs::MarkerArray,
    wm_msgs::{ActionChunk, ExecutorStatus, Plan, Timing},
};

use wm_wire::marker::{Style, edges};

use super::{Command, State, Status, Velocity, status::STATUS_PERIOD};

/// vx, vy, vz, wx, wy, wz.
const AXES: u32 = 6;

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

/// A plan as a chunk, as a policy would publish it.
pub(super) fn chunk(plan: &Plan) -> ActionChunk {
    let first = plan.actions.first();
    ActionChunk {
        header: first.map_or(&plan.header, |action| &action.header).clone(),
        period: plan.period,
        actions: plan.actions.clone(),
        timing: Timing {
            capture: plan.header.stamp,
            ..Timing::default()
        },
    }
}

pub(super) fn twist(header: Header, velocity: Velocity) -> TwistStamped {
    TwistStamped {
        header,
        twist: Twist {
            linear: vector(velocity.linear),
            angular: vector(velocity.angular),
        },
    }
}

/// One dimension of six: vx, vy, vz \[m/s\], wx, wy, wz \[rad/s\].
pub(super) fn array(velocity: Velocity) -> Float64MultiArray {
    Float64MultiArray {
        layout: MultiArrayLayout {
            dim: vec![MultiArrayDimension {
                label: "vx vy vz wx wy wz".into(),
                size: AXES,
                stride: AXES,
            }],
            data_offset: 0,
        },
        data: velocity
            .linear
            .into_iter()
            .chain(velocity.angular)
            .collect(),
    }
}

/// One point: positions and velocities of the joints at the end of the command period. It begins at once, independent
/// of the arm's clock.
pub(super) fn trajectory(
    frame_id: String,
    joint_names: &[String],
    command: &Command,
    period_ns: i64,
) -> JointTrajectory {
    let places = command.places.map(|places| places.as_slice().to_vec());
    JointTrajectory {
        header: Header {
            stamp: Time::default(),
            frame_id,
        },
        joint_names: joint_names.to_vec(),
        points: vec![JointTrajectoryPoint {
            // Empty, if the arm's places are unknown: the message has velocities alone.
            positions: places.unwrap_or_default(),
            velocities: command.velocity.as_slice().to_vec(),
            time_from_start: Duration::from_nanos(period_ns),
            ..JointTrajectoryPoint::default()
        }],
    }
}

/// The edges of the workspace box, in orange; they outlive two statuses that are lost.
pub(super) fn workspace(header: Header, (least, most): ([f64; 3], [f64; 3])) -> MarkerArray {
    let style = Style {
        ns: "workspace",
        color: [1.0, 0.6, 0.0, 0.8],
        lifetime: STATUS_PERIOD * 3,
    };
    MarkerArray {
        markers: vec![edges(header, &style, least, most)],
    }
}

pub(super) fn status(header: Header, status: &Status) -> ExecutorStatus {
    let counts = status.counts;
    ExecutorStatus {
        header,
        state: match status.state {
            State::DryRun => ExecutorStatus::DRY_RUN,
            State::Idle => ExecutorStatus::IDLE,
            State::Executing => ExecutorStatus::EXECUTING,
            State::Stopping => ExecutorStatus::STOPPING,
            State::Stopped => ExecutorStatus::STOPPED,
        },
        reason: status.reason.clone(),
        // Zero without an offer.
        chunk_stamp: status.offer_ns.map(Time::from_nanos).unwrap_or_default(),
        begun: counts.begun,
        refused: counts.refused,
        vetoed: counts.vetoed,
        interrupted: counts.interrupted,
    }
}
