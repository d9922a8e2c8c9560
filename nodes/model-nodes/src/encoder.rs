//! The encoder node: camera images in, latents out.
//!
//! [`EncoderStep`] is the node without its ROS interface. `/camera/image_raw` and its `/compressed` sibling carry the
//! same frames; the node takes either, and if a frame arrives on both, only the first.
//!
//! The node also monitors the camera itself (`stillness.rs`): a camera that has stopped may publish on with fresh stamps, and
//! no other node receives all of its frames.

mod choice;
mod decoding;
mod job;
mod node;
mod other_transports;
mod parameters;
mod picture_size;
mod repeats;
mod repetition;
mod step;
mod stillness;

pub use choice::{Choice, Fate, Mode, Needs};
pub use node::NODE;
pub use picture_size::Mismatch;
pub(crate) use repeats::{Arrival, JUMP_NS, Repeats};
pub(crate) use repetition::{Repeat, Repetition};
pub(crate) use step::expect_scene;
pub use step::{EncoderError, EncoderStep};
pub(crate) use stillness::{FreezeReason, Grid, Sight, Stillness};
