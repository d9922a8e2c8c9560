//! Camera frames: raw and compressed image messages to RGB and back, and the camera of a bag. All camera images are
//! decoded here: live, in training and in exports.

mod bayer;
pub mod camera_frame;
pub mod camera_info;
mod encoding;
pub mod format;
pub mod foxglove;
pub mod goal;
pub mod image_message;
pub mod jpeg;
pub mod protobuf_topics;
pub mod raw_image;
pub mod signature;
pub mod transport;
#[cfg(feature = "video")]
pub mod video;
pub mod yuv;
