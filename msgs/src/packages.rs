//! One module a ROS package, named as the package.

/// Names and definitions of message types and of all that they name, each once.
macro_rules! dependencies {
    ($($field:ty),*) => {{
        #[allow(unused_mut, reason = "a type of primitives alone has none")]
        let mut all: Vec<(&'static str, &'static str)> = Vec::new();
        $(
            let own = (<$field as $crate::packages::Named>::ROS_NAME, <$field as $crate::Message>::DEFINITION);
            for dependency in std::iter::once(own).chain(<$field as $crate::Message>::dependencies()) {
                if !all.contains(&dependency) {
                    all.push(dependency);
                }
            }
        )*
        all
    }};
}

/// Implements [`Message`](crate::Message) for a struct: its package, its definition, and the message types that
/// its fields name.
macro_rules! message {
    ($type:ident, $package:literal, $definition:expr, [$($field:ty),*]) => {
        impl $crate::Message for $type {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($type);
            const DEFINITION: &'static str = $definition;

            fn dependencies() -> Vec<(&'static str, &'static str)> {
                dependencies!($($field),*)
            }
        }

        impl $crate::packages::Named for $type {
            const ROS_NAME: &'static str = concat!($package, "/msg/", stringify!($type));
        }
    };
}

/// Implements [`Service`](crate::Service) for a unit struct: its package, its definition, its two structs, and the
/// message types that their fields name.
macro_rules! service {
    ($type:ident, $package:literal, $definition:expr, $request:ty, $response:ty, [$($field:ty),*]) => {
        impl $crate::Service for $type {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($type);
            const DEFINITION: &'static str = $definition;
            type Request = $request;
            type Response = $response;

            fn dependencies() -> Vec<(&'static str, &'static str)> {
                dependencies!($($field),*)
            }
        }
    };
}

/// Implements [`Action`](crate::Action) for a unit struct: its package, its definition, its three structs, and the
/// message types that their fields name.
macro_rules! action {
    ($type:ident, $package:literal, $definition:expr, $goal:ty, $result:ty, $feedback:ty, [$($field:ty),*]) => {
        impl $crate::Action for $type {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($type);
            const DEFINITION: &'static str = $definition;
            type Goal = $goal;
            type Result = $result;
            type Feedback = $feedback;

            fn dependencies() -> Vec<(&'static str, &'static str)> {
                dependencies!($($field),*)
            }
        }
    };
}

/// The ROS name as a constant: `Message::ros_name` has to build it at run time.
pub(crate) trait Named {
    const ROS_NAME: &'static str;
}

pub mod action_msgs;
pub mod builtin_interfaces;
pub mod diagnostic_msgs;
pub mod geometry_msgs;
pub mod lifecycle_msgs;
pub mod rcl_interfaces;
pub mod rosbag2_interfaces;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub(crate) mod service_msgs;
pub mod std_msgs;
pub mod std_srvs;
pub mod tf2_msgs;
pub mod trajectory_msgs;
pub mod unique_identifier_msgs;
pub mod vision_msgs;
pub mod visualization_msgs;
pub mod wm_msgs;
