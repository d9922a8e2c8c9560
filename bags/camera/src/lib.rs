//! Camera frames: raw and compressed image messages to RGB and back, and the camera of a bag. All camera images are
//! decoded here: live, in training and in exports.

pub mod camera_frame;
pub mod camera_info;
pub mod goal;
pub mod image_message;
pub mod signature;
