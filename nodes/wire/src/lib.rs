//! Conversions shared by the nodes: latents with the checks before a model, the two transports of an image topic,
//! markers for viewers, the allowed lead of stamps, and coordinate frames from tf.

pub mod frames;
pub mod latent_message;
pub mod marker;
pub mod stamp;
pub mod transport;
