//! Conversions shared by the nodes: latents with the checks before a model, the two transports of an image topic,
//! markers for viewers, and the allowed lead of stamps.

pub mod latent_message;
pub mod marker;
pub mod stamp;
pub mod transport;
