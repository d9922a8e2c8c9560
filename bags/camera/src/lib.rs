//! Camera frames: converts raw and compressed image messages to RGB and back, and selects the camera of a bag. Live nodes,
//! training and exports all decode camera images with this crate.

mod bayer;
pub mod camera_frame;
pub mod camera_info;
mod encoding;
mod error;
pub mod format;
pub mod foxglove;
pub mod goal;
pub mod image_message;
pub mod jpeg;
mod limits;
pub mod protobuf_topics;
mod raw_image;
pub mod recent_pictures;
pub mod signature;
pub mod transport;
#[cfg(feature = "video")]
pub mod video;
pub mod yuv;
