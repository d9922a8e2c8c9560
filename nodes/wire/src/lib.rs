//! Latents between ROS messages and values, with what is checked before one reaches a model; the two transports of an
//! image topic; shapes for viewers.

pub mod latent_message;
pub mod marker;
pub mod transport;
