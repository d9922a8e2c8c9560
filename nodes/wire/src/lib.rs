//! Latents between ROS messages and values, with what is checked before one reaches a model, and the two transports of an
//! image topic.

pub mod latent_message;
pub mod transport;
