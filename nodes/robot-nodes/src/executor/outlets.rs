//! The executor's topics and services.

use std::time::Duration;

use anyhow::Result;
use wm_msgs::{
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    std_msgs::{Bool, Float64, Float64MultiArray},
    std_srvs::{SetBool, Trigger},
    trajectory_msgs::JointTrajectory,
    visualization_msgs::MarkerArray,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, CameraState, ExecutorStatus, Plan,
        PredictionError,
    },
};
use wm_ros::{Error, Node, Publisher, Qos, Requests, Service, Subscription};

/// How long the last command may take to arrive: less than a process has to end after a signal.
const FAREWELL: Duration = Duration::from_millis(300);
/// Only the newest command counts.
const COMMANDS: Qos = Qos::reliable(1);

wm_ros::endpoints! {
    /// Topics and services.
    pub(super) struct Endpoints {
        /// Subscriptions.
        pub(super) inlets: Inlets;
        /// Publishers.
        pub(super) outlets: Outlets;
        /// Requests of clients.
        pub(super) requests: Requests<Request>;
    }
}

wm_ros::endpoints! {
    /// Requests of clients.
    pub(super) enum Request {
        /// Arms the node (true), or decelerates and disarms it (false).
        Arm(Service<SetBool>) = "~/arm";
        /// Emergency stop: zero velocity at once, until ~/reset and ~/arm.
        Stop(Service<Trigger>) = "~/stop";
        /// Ends an emergency stop and forgets everything; the node is not armed.
        Reset(Service<Trigger>) = "~/reset";
    }
}

wm_ros::endpoints! {
    /// Messages about the robot, its policy and its planner.
    pub(super) struct Inlets {
        /// A policy's next actions, unless source is plan.
        pub(super) chunks: Option<Subscription<ActionChunk>> = "action_chunk", if(|node| is_executed(node, "chunk"));
        /// A planner's plans, unless source is chunk.
        pub(super) plans: Option<Subscription<Plan>> = "plan", if(|node| is_executed(node, "plan"));
        /// Where the end effector is, for the workspace box.
        pub(super) poses: Subscription<PoseStamped> = "ee_pose", qos(Qos::best_effort(1));
        /// Where the joints are, with command_type joint_trajectory.
        pub(super) joints: Option<Subscription<JointState>> = "joint_states", qos(Qos::best_effort(10)),
            if(|node| is_chosen(node, "joint_trajectory"));
        /// True while a person allows motion, with require_deadman.
        pub(super) deadman: Subscription<Bool> = "deadman", qos(Qos::best_effort(1));
        /// True: emergency stop. Reliable or best effort, volatile or latched.
        pub(super) emergency: Subscription<Bool> = "emergency_stop", made(|node, name, qos| {
            node.subscription_to_any(name, qos)
        });
        /// Whether the camera has stopped, from the encoder.
        pub(super) cameras: Subscription<CameraState> = "camera_state";
        /// The chunks that a policy chooses from, to which assessments refer.
        pub(super) candidates: Subscription<ActionCandidates> = "action_candidates";
        /// What the model predicts of them, for the veto.
        pub(super) assessments: Subscription<Assessment> = "assessment";
        /// What predictions were worth, for the veto.
        pub(super) errors: Subscription<PredictionError> = "prediction_error", qos(Qos::best_effort(16));
    }
}

wm_ros::endpoints! {
    /// Commands, and reports about them.
    #[derive(Clone)]
    pub(super) struct Outlets {
        /// Velocities in the robot's base frame, with command_type twist.
        pub(super) twists: Option<Publisher<TwistStamped>> = "command/twist", qos(COMMANDS),
            if(|node| is_chosen(node, "twist"));
        /// The same as vx, vy, vz [m/s], wx, wy, wz [rad/s], with command_type velocity.
        pub(super) velocities: Option<Publisher<Float64MultiArray>> = "command/velocity", qos(COMMANDS),
            if(|node| is_chosen(node, "velocity"));
        /// The motion of each command period, with command_type action.
        pub(super) motions: Option<Publisher<Action>> = "command/action", qos(COMMANDS),
            if(|node| is_chosen(node, "action"));
        /// Where the joints are to be at the end of each command period, one point, with command_type joint_trajectory.
        pub(super) trajectories: Option<Publisher<JointTrajectory>> = "command/joint_trajectory", qos(COMMANDS),
            if(|node| is_chosen(node, "joint_trajectory"));
        /// The gripper's opening, 0 closed to 1 open.
        pub(super) gripper: Publisher<Float64> = "command/gripper", qos(COMMANDS);
        /// While not armed: the velocities that would be sent.
        pub(super) previews: Option<Publisher<TwistStamped>> = "~/command_preview", qos(COMMANDS),
            if(|node| Ok(!is_chosen(node, "joint_trajectory")?));
        /// The same of joints.
        pub(super) joint_previews: Option<Publisher<JointTrajectory>> = "~/joint_trajectory_preview", qos(COMMANDS),
            if(|node| is_chosen(node, "joint_trajectory"));
        /// What was done in each command period, with publish_action.
        pub(super) actions: Option<Publisher<Action>> = "action", if(|node| node.parameter("publish_action"));
        /// What is going to be done, with announce_plans.
        pub(super) announcements: Option<Publisher<ActionChunk>> = "action_chunk", if(|node| node.parameter("announce_plans"));
        /// The workspace box (ns workspace), where there is one. Sent with the status, while somebody subscribes.
        pub(super) shapes: Option<Publisher<MarkerArray>> = "markers", qos(Qos::reliable(4)),
            if(|node| Ok(!node.parameter::<Vec<f64>>("workspace_min")?.is_empty()));
        /// What the node does, and why.
        pub(super) status: Publisher<ExecutorStatus> = "~/status", qos(Qos::latched(1));
    }
}

/// Whether commands of this type are sent.
fn is_chosen(node: &Node, command_type: &str) -> Result<bool, Error> {
    let wanted: String = node.parameter("command_type")?;
    Ok(wanted == command_type)
}

/// Whether offers of this kind are executed.
fn is_executed(node: &Node, source: &str) -> Result<bool, Error> {
    let wanted: String = node.parameter("source")?;
    Ok(wanted == source || wanted == "both")
}

impl Outlets {
    /// Waits, but not for long, until the last command has arrived: a node that has ended repeats nothing.
    pub(super) async fn settle(&self) -> Result<()> {
        if let Some(twists) = &self.twists {
            twists.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(velocities) = &self.velocities {
            velocities.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(motions) = &self.motions {
            motions.wait_for_acknowledgments(FAREWELL).await?;
        }
        if let Some(trajectories) = &self.trajectories {
            trajectories.wait_for_acknowledgments(FAREWELL).await?;
        }
        Ok(())
    }
}
