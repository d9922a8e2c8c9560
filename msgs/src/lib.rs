//! Rust types of ROS 2 messages, services and actions: the interface package `wm_msgs`, and the types of other packages
//! that the suite uses.
//!
//! The build script writes them from definition files: `msg/`, `srv/` and `action/` of this package, and `ros/` for the
//! packages of others. Each ROS package is a module. Each type has its name, its definition and its dependencies through
//! [`Message`], [`Service`] or [`Action`], and its documentation from the comments of its file.
//!
//! ```
//! use wm_msgs::{Message, TypeDescription, builtin_interfaces::Time, cdr, std_msgs::Header};
//!
//! let header = Header { stamp: Time::from_nanos(1_500_000_000), frame_id: "base_link".into() };
//! let bytes = cdr::to_bytes(&header)?;
//! assert_eq!(cdr::from_bytes::<Header>(&bytes)?, header);
//!
//! assert_eq!(Header::ros_name(), "std_msgs/msg/Header");
//! assert_eq!(Header::DEFINITION, "builtin_interfaces/Time stamp\nstring frame_id\n");
//! let hash = TypeDescription::of::<Header>()?.hash();
//! assert_eq!(hash.to_string(), "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! - [`cdr`]: messages as bytes, and bytes as messages.
//! - [`TypeDescription`]: the fields of a type, from its definition, and the hash that identifies it.
//! - [`MessageType`]: a message type of this crate, found by its name.
//! - [`Mapping`]: messages of one definition as messages of another, for bags of another version.
//!
//! A new message of this package is a new file in `msg/`, and its name in `CMakeLists.txt`.
//!
//! Not here: transport and QoS (`wm_ros`), bags (`wm_bag`).

pub mod action;
pub mod cdr;
mod mapping;
mod message;
mod message_type;
mod time;
mod type_description;

pub use mapping::{ConvertError, Layout, Mapping, MappingError};
pub use message::{Action, Message, Service};
pub use message_type::MessageType;
pub use time::InvalidNanoseconds;
pub use type_description::{
    DescriptionError, Field, FieldType, IndividualType, TypeDescription, TypeHash, idl_definitions,
};

include!(concat!(env!("OUT_DIR"), "/packages.rs"));

impl wm_msgs::CameraState {
    /// The [`change`](Self::change) of a frame without a predecessor.
    pub const NOT_MEASURED: f32 = -1.0;
}
