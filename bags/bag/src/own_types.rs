//! The message types of this suite.

use std::sync::LazyLock;

use wm_msgs::{
    DescriptionError, Message, TypeDescription, diagnostic_msgs, geometry_msgs, lifecycle_msgs,
    rosgraph_msgs, sensor_msgs, std_msgs, tf2_msgs, trajectory_msgs, vision_msgs,
    visualization_msgs,
    wm_msgs::{
        Action, ActionCandidates, ActionChunk, Assessment, CameraState, EnvObservation,
        ExecutorStatus, Goal, Latent, LatentSpace, Plan, Prediction, PredictionError,
    },
};

/// A message type of this suite.
pub(crate) struct OwnType {
    name: String,
    /// The `.msg` text.
    pub definition: &'static str,
    /// Name and `.msg` text of each type that the definition uses.
    pub dependencies: Vec<(&'static str, &'static str)>,
    pub description: fn() -> Result<TypeDescription, DescriptionError>,
}

fn own_type<M: Message>() -> OwnType {
    OwnType {
        name: M::ros_name(),
        definition: M::DEFINITION,
        dependencies: M::dependencies(),
        description: TypeDescription::of::<M>,
    }
}

static OWN_TYPES: LazyLock<Vec<OwnType>> = LazyLock::new(|| {
    vec![
        own_type::<std_msgs::Header>(),
        own_type::<std_msgs::String>(),
        own_type::<std_msgs::Bool>(),
        own_type::<std_msgs::Float32>(),
        own_type::<std_msgs::Float64>(),
        own_type::<std_msgs::Float64MultiArray>(),
        own_type::<sensor_msgs::Image>(),
        own_type::<sensor_msgs::CompressedImage>(),
        own_type::<sensor_msgs::CameraInfo>(),
        own_type::<sensor_msgs::JointState>(),
        own_type::<geometry_msgs::Pose>(),
        own_type::<geometry_msgs::PoseStamped>(),
        own_type::<geometry_msgs::TwistStamped>(),
        own_type::<geometry_msgs::PoseArray>(),
        own_type::<diagnostic_msgs::DiagnosticArray>(),
        own_type::<rosgraph_msgs::Clock>(),
        own_type::<tf2_msgs::TFMessage>(),
        own_type::<trajectory_msgs::JointTrajectory>(),
        own_type::<vision_msgs::LabelInfo>(),
        own_type::<visualization_msgs::MarkerArray>(),
        own_type::<lifecycle_msgs::TransitionEvent>(),
        own_type::<LatentSpace>(),
        own_type::<Latent>(),
        own_type::<Action>(),
        own_type::<ActionChunk>(),
        own_type::<ActionCandidates>(),
        own_type::<Assessment>(),
        own_type::<EnvObservation>(),
        own_type::<Goal>(),
        own_type::<Prediction>(),
        own_type::<PredictionError>(),
        own_type::<Plan>(),
        own_type::<CameraState>(),
        own_type::<ExecutorStatus>(),
    ]
});

/// The type `package/msg/Type`, if it is one of this suite.
pub(crate) fn find(type_name: &str) -> Option<&'static OwnType> {
    OWN_TYPES.iter().find(|own| own.name == type_name)
}

/// Name and `.msg` text of a type that a type of this suite uses.
pub(crate) fn find_dependency(type_name: &str) -> Option<(&'static str, &'static str)> {
    let mut dependencies = OWN_TYPES.iter().flat_map(|own| &own.dependencies);
    dependencies.find(|(name, _)| *name == type_name).copied()
}
