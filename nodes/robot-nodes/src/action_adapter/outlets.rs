//! The adapter's topics.

use wm_msgs::{
    geometry_msgs::{PoseStamped, TwistStamped},
    sensor_msgs::JointState,
    std_msgs::Float64,
    tf2_msgs::TFMessage,
    wm_msgs::Action,
};
use wm_ros::{Error, Node, Publisher, Qos, Subscription};

wm_ros::endpoints! {
    /// Topics.
    pub(super) struct Endpoints {
        /// Subscriptions.
        pub(super) inlets: Inlets;
        /// Publishers.
        pub(super) outlets: Outlets;
    }
}

wm_ros::endpoints! {
    /// The arm's motions and its gripper.
    pub(super) struct Inlets {
        /// Velocities of the end effector in the base frame, with source twist.
        pub(super) twists: Option<Subscription<TwistStamped>> = "twist", qos(Qos::best_effort(100)),
            if(|node| is_chosen(node, "source", "twist"));
        /// Where the end effector is, with source pose.
        pub(super) poses: Option<Subscription<PoseStamped>> = "ee_pose", qos(Qos::best_effort(100)),
            if(|node| is_chosen(node, "source", "pose"));
        /// Frames that move, with source tf.
        pub(super) transforms: Option<Subscription<TFMessage>> = "/tf", qos(Qos::best_effort(100)),
            if(|node| is_chosen(node, "source", "tf"));
        /// Frames that do not.
        pub(super) static_transforms: Option<Subscription<TFMessage>> = "/tf_static", qos(Qos::reliable(100)),
            made(|node, name, qos| {
                is_chosen(node, "source", "tf")?
                    .then(|| node.subscription_catching_up(name, qos))
                    .transpose()
            });
        /// How far the gripper is open, 0 closed to 1 open, with gripper topic.
        pub(super) openings: Option<Subscription<Float64>> = "gripper", qos(Qos::best_effort(100)),
            if(|node| is_chosen(node, "gripper", "topic"));
        /// Where the joints are, with source joints or gripper joint.
        pub(super) joints: Option<Subscription<JointState>> = "joint_states", qos(Qos::best_effort(100)),
            if(|node| Ok(is_chosen(node, "source", "joints")? || is_chosen(node, "gripper", "joint")?));
    }
}

wm_ros::endpoints! {
    /// Actions, and the arm's state by what it publishes.
    #[derive(Clone)]
    pub(super) struct Outlets {
        /// What was done in each period; its stamp is the period's beginning.
        pub(super) actions: Publisher<Action> = "action";
        /// Where the end effector is by the transforms, with source tf.
        pub(super) states: Option<Publisher<PoseStamped>> = "ee_pose", if(|node| is_chosen(node, "source", "tf"));
        /// How far the gripper is open by its joint, with gripper joint.
        pub(super) grippers: Option<Publisher<Float64>> = "gripper", if(|node| is_chosen(node, "gripper", "joint"));
    }
}

/// Whether a parameter has this value.
fn is_chosen(node: &Node, parameter: &str, choice: &str) -> Result<bool, Error> {
    let chosen: String = node.parameter(parameter)?;
    Ok(chosen == choice)
}
