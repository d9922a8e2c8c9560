//! Camera frames: raw and compressed image messages as RGB and back, and the camera of a bag. What a camera sends is
//! decoded here, live, in training and in exports alike.

pub mod camera_frame;
pub mod goal;
pub mod image_message;
