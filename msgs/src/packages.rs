//! One module a ROS package, named as the package.

/// Implements [`Message`](crate::Message) for a struct: its package, its definition, and the message types that
/// its fields name.
macro_rules! message {
    ($type:ident, $package:literal, $definition:expr, [$($field:ty),*]) => {
        impl $crate::Message for $type {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($type);
            const DEFINITION: &'static str = $definition;

            fn dependencies() -> Vec<(&'static str, &'static str)> {
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
            }
        }

        impl $crate::packages::Named for $type {
            const ROS_NAME: &'static str = concat!($package, "/msg/", stringify!($type));
        }
    };
}

/// The ROS name as a constant: `Message::ros_name` has to build it at run time.
pub(crate) trait Named {
    const ROS_NAME: &'static str;
}

pub mod builtin_interfaces;
pub mod diagnostic_msgs;
pub mod geometry_msgs;
pub mod rosgraph_msgs;
pub mod sensor_msgs;
pub mod std_msgs;
pub mod wm_msgs;
