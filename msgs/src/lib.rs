//! Rust types of the ROS 2 interface package `wm_msgs` (the `.msg`, `.srv` and `.action` files beside this
//! crate), and of the few standard ROS messages that the suite uses.
//!
//! Each package is a module named as in ROS; each type carries its ROS name and its definition through
//! [`Message`], so that a bag's schema, a DDS type name and the Rust struct cannot drift apart: a test holds
//! every struct against its `.msg` file, field by field.
//!
//! ```
//! use wm_msgs::{Message, builtin_interfaces::Time, cdr, std_msgs::Header};
//!
//! let header = Header { stamp: Time::from_nanos(1_500_000_000), frame_id: "base_link".into() };
//! let bytes = cdr::to_bytes(&header)?;
//! assert_eq!(cdr::from_bytes::<Header>(&bytes)?, header);
//! assert_eq!(Header::ros_name(), "std_msgs/msg/Header");
//! # Ok::<(), cdr::CdrError>(())
//! ```
//!
//! Not here: transport, QoS (`wm_ros`), bags (`wm_bag`).

pub mod action;
pub mod cdr;
mod mapping;
mod message;
mod packages;
mod type_description;

pub use mapping::{ConvertError, Layout, Mapping, MappingError};
pub use message::{Action, Message, Service};
pub use packages::{
    action_msgs, builtin_interfaces, diagnostic_msgs, geometry_msgs, lifecycle_msgs,
    rcl_interfaces, rosbag2_interfaces, rosgraph_msgs, sensor_msgs, std_msgs, std_srvs, tf2_msgs,
    trajectory_msgs, unique_identifier_msgs, vision_msgs, visualization_msgs, wm_msgs,
};
pub use type_description::{
    DescriptionError, Field, FieldType, IndividualType, TypeDescription, TypeHash, idl_definitions,
};
