//! A model behind an OpenAI-compatible endpoint.

mod api_key;
mod backoff;
mod client;
mod clock;
mod completion;
mod pace;
mod picture;
mod request;
mod settings;

pub use client::{Client, MAX_BODY_BYTES};
pub use clock::{Clock, SystemClock};
pub use completion::{Reply, Usage};
pub use picture::{Detail, Picture, PictureFormat, PictureSettings};
pub use request::{Sampling, request};
pub use settings::{EndpointSettings, Price, TextPlace};
