//! The simulated arm's topics and services, and its publications.

use std::time::Duration;

use anyhow::Result;
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{PoseArray, PoseStamped, TwistStamped},
    rosgraph_msgs::Clock,
    sensor_msgs::{CameraInfo, JointState},
    std_msgs::{Bool, Float64, Float64MultiArray, String as Text},
    tf2_msgs::TFMessage,
    vision_msgs::LabelInfo,
    visualization_msgs::MarkerArray,
    wm_msgs::{Action, Goal, Reset},
};
use wm_ros::{Publisher, Qos, Requests, Service, Subscription};
use wm_sim::{BASE_FRAME, INSTRUCTION_TOPIC, SUCCESS_TOPIC};
use wm_wire::transport::{ImagePublisher, Pictures, Transports};

use super::{Frame, SimArmStep, Tick, View, message};

/// Longest wait for the acknowledgement of the last message.
const FAREWELL: Duration = Duration::from_millis(300);

wm_ros::endpoints! {
    /// Topics and services.
    pub(super) struct Endpoints {
        /// Commands.
        pub(super) inlets: Inlets;
        /// What the arm shows.
        pub(super) outlets: Outlets;
        /// Requests of clients.
        pub(super) requests: Requests<Request>;
    }
}

wm_ros::endpoints! {
    /// Requests of clients.
    pub(super) enum Request {
        /// Begins the task anew, with the seed and the parameter task.
        Reset(Service<Reset>) = "~/reset";
    }
}

wm_ros::endpoints! {
    /// Commands.
    pub(super) struct Inlets {
        /// Velocities of the tool in the base frame. The newest one counts.
        pub(super) twists: Subscription<TwistStamped> = "command/twist", qos(Qos::best_effort(1));
        /// The same as vx, vy, vz [m/s], wx, wy, wz [rad/s].
        pub(super) velocities: Subscription<Float64MultiArray> = "command/velocity", qos(Qos::best_effort(1));
        /// Motions, each to be done once. What comes within a step adds up.
        pub(super) motions: Subscription<Action> = "command/action", qos(Qos::reliable(100));
        /// The gripper's opening, 0 closed to 1 open.
        pub(super) openings: Subscription<Float64> = "command/gripper";
    }
}

wm_ros::endpoints! {
    /// Pictures, poses and the state of the task.
    pub(super) struct Outlets {
        /// What the camera sees, 256 by 256, after each step.
        pub(super) pictures: ImagePublisher = "/camera/image_raw";
        /// How the camera sees, with each picture.
        pub(super) camera_infos: Publisher<CameraInfo> = "/camera/camera_info";
        /// What the second camera sees, with front_camera.
        pub(super) front_pictures: Option<ImagePublisher> = "/front_camera/image_raw",
            if(|node| node.parameter("front_camera"));
        /// How it sees.
        pub(super) front_infos: Option<Publisher<CameraInfo>> = "/front_camera/camera_info",
            if(|node| node.parameter("front_camera"));
        /// What it would see once the task is done.
        pub(super) goals: ImagePublisher = "goal/image", qos(Qos::latched(1));
        /// The same as a goal of one or several pictures, as goal_period has it.
        pub(super) ways: Publisher<Goal> = "goal", qos(Qos::latched(1));
        /// The task in words.
        pub(super) instructions: Publisher<Text> = INSTRUCTION_TOPIC, qos(Qos::latched(1));
        /// Whether the task is done: at the start, after a reset, and when that changes.
        pub(super) successes: Publisher<Bool> = SUCCESS_TOPIC, qos(Qos::latched(1));
        /// Where the tool is.
        pub(super) poses: Publisher<PoseStamped> = "ee_pose";
        /// How far the gripper is open, 0 closed to 1 open.
        pub(super) grippers: Publisher<Float64> = "gripper";
        /// The arm's joints and fingers [rad, m].
        pub(super) joints: Publisher<JointState> = "joint_states";
        /// The arm as a URDF.
        pub(super) descriptions: Publisher<Text> = "robot_description", qos(Qos::latched(1));
        /// The tool's frame, and those of the arm's links.
        pub(super) transforms: Publisher<TFMessage> = "/tf", qos(Qos::reliable(100));
        /// The cameras' optical frames; each seed has them a little elsewhere.
        pub(super) static_transforms: Publisher<TFMessage> = "/tf_static", qos(Qos::latched(1));
        /// Where the objects really are.
        pub(super) objects: Publisher<PoseArray> = "~/objects";
        /// Their names: a class_id is the place in objects.
        pub(super) object_names: Publisher<LabelInfo> = "~/object_names", qos(Qos::latched(1));
        /// The time, with a real_time_factor other than 1.
        pub(super) clock: Option<Publisher<Clock>> = "/clock", qos(Qos::reliable(1)),
            if(|node| Ok(node.parameter::<f64>("real_time_factor")? != 1.0));
        /// What was done in each step, with publish_action; its stamp is that of the picture before.
        pub(super) actions: Option<Publisher<Action>> = "action",
            if(|node| node.parameter("publish_action"));
        /// Where the tool or an object is to be (ns goal), while somebody subscribes.
        pub(super) shapes: Publisher<MarkerArray> = "markers", qos(Qos::reliable(4));
        /// What is missing to the goal [m].
        pub(super) distances: Publisher<Float64> = "~/distance";
    }
}

/// The messages of a picture.
pub(super) struct EncodedFrame {
    view: View,
    pictures: Pictures,
    info: CameraInfo,
}

/// Encodes pictures as messages.
///
/// # Errors
/// A picture cannot be compressed.
pub(super) fn encode(
    step: &SimArmStep,
    frames: &[Frame],
    transports: Transports,
) -> Result<Vec<EncodedFrame>> {
    let mut all = Vec::with_capacity(frames.len());
    for Frame {
        view,
        stamp_ns,
        picture,
    } in frames
    {
        let Some((_, eye)) = step.eyes().find(|(other, _)| other == view) else {
            continue;
        };
        all.push(EncodedFrame {
            view: *view,
            pictures: message::pictures(picture, *view, *stamp_ns, transports)?,
            info: message::camera_info(eye, *view, *stamp_ns),
        });
    }
    Ok(all)
}

/// The names of frames.
pub(super) struct Names {
    /// The frame of published messages; empty: none is named.
    pub(super) base: String,
    /// The frame of the tool.
    pub(super) tool: String,
}

impl Names {
    /// The base frame, which a transform has to name.
    fn root(&self) -> &str {
        match self.base.as_str() {
            "" => BASE_FRAME,
            base => base,
        }
    }
}

impl Outlets {
    /// Publishes the messages that hold until a reset: task, goal, arm and camera frames.
    pub(super) fn announce(
        &self,
        step: &SimArmStep,
        now_ns: i64,
        names: &Names,
        transports: Transports,
    ) -> Result<()> {
        let goal = message::pictures(step.goal_picture(), View::Side, now_ns, transports)?;
        self.goals.publish(&goal)?;
        self.ways.publish(&message::goal(step.goals(), now_ns))?;
        let data = step.instruction().to_owned();
        self.instructions.publish(&Text { data })?;
        let data = wm_sim::urdf(names.root());
        self.descriptions.publish(&Text { data })?;
        let cameras = message::camera_transforms(step, now_ns, names.root());
        self.static_transforms.publish(&cameras)?;
        let objects = message::object_names(step.world(), now_ns, &names.base);
        self.object_names.publish(&objects)?;
        Ok(())
    }

    /// Publishes the time if the node makes it.
    pub(super) fn publish_time(&self, now_ns: i64) -> Result<()> {
        if let Some(clock) = &self.clock {
            clock.publish(&Clock {
                clock: Time::from_nanos(now_ns),
            })?;
        }
        Ok(())
    }

    /// Publishes the result of a step.
    pub(super) fn publish(&self, step: &SimArmStep, tick: &Tick, names: &Names) -> Result<()> {
        if let (Some(actions), Some(done)) = (&self.actions, &tick.done) {
            actions.publish(&message::action(done, &names.base))?;
        }
        self.poses.publish(&message::pose(tick, &names.base))?;
        let transforms = message::transforms(tick, names.root(), &names.tool);
        self.transforms.publish(&transforms)?;
        if self.shapes.subscribers() > 0 {
            let target = message::target(step.target(), tick.stamp_ns, names.root());
            self.shapes.publish(&target)?;
        }
        self.grippers.publish(&Float64 { data: tick.opening })?;
        if let Some(positions) = tick.joints {
            let joints = message::joints(positions, tick.stamp_ns);
            self.joints.publish(&joints)?;
        }
        let objects = message::objects(step.world(), tick.stamp_ns, &names.base);
        self.objects.publish(&objects)?;
        let data = tick.distance_m;
        self.distances.publish(&Float64 { data })?;
        if let Some(data) = tick.success {
            self.successes.publish(&Bool { data })?;
        }
        Ok(())
    }

    /// Publishes pictures.
    pub(super) fn show(&self, frames: &[EncodedFrame]) -> Result<()> {
        for EncodedFrame {
            view,
            pictures,
            info,
        } in frames
        {
            let (images, infos) = match view {
                View::Side => (Some(&self.pictures), Some(&self.camera_infos)),
                View::Front => (self.front_pictures.as_ref(), self.front_infos.as_ref()),
            };
            if let Some(infos) = infos {
                infos.publish(info)?;
            }
            if let Some(images) = images {
                images.publish(pictures)?;
            }
        }
        Ok(())
    }

    /// Waits for the acknowledgement of the outcome, at most for [`FAREWELL`], so that a recorder gets it.
    pub(super) async fn settle(&self) -> Result<()> {
        self.successes.wait_for_acknowledgments(FAREWELL).await?;
        Ok(())
    }
}
