//! Images and latents between ROS messages and values: what is checked before it reaches a model, and the two transports
//! of an image topic.

pub mod camera_frame;
pub mod goal;
pub mod image_message;
pub mod latent_message;
pub mod transport;
