//! Latents between ROS messages and values, with what is checked before one reaches a model; the two transports of an
//! image topic; shapes for viewers; the lead that stamps may have; coordinate frames in each other, as tf publishes them.

pub mod frames;
pub mod latent_message;
pub mod marker;
pub mod stamp;
pub mod transport;
