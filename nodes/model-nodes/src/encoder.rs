//! The encoder node: camera images in, latents out.
//!
//! [`EncoderStep`] is the node without its ROS interface. `/camera/image_raw` and its `/compressed` sibling carry the
//! same frames; the node takes either, and if a frame arrives on both, only the first.
//!
//! The node also watches the camera itself (`stillness.rs`): one that has stopped may go on with fresh stamps, and no other
//! node receives all of its frames.

mod choice;
mod looks;
mod node;
mod other_transports;
mod picture_size;
mod repeats;
mod repetition;
mod step;
mod stillness;

pub use choice::{Choice, Fate, Mode, Needs};
pub use node::{NODE, body};
pub use picture_size::Mismatch;
pub(crate) use repetition::{Repeat, Repetition};
pub use step::{EncoderError, EncoderStep};
pub(crate) use stillness::{Grid, Sight, Stillness};
