//! The node views: frames of several cameras in, one picture out, with the cameras side by side as in the training of a
//! model of several views.
//!
//! [`Matcher`] finds the frames of one moment by their stamps; [`Joiner`] makes a picture of them, by the model's own rule
//! ([`Framing::join`]). Neither knows DDS or a clock. The picture has stamp and frame of the first camera, as in training.
//!
//! Without a frame of each camera there is no picture: a model cannot predict from a view that it was not trained with.
//!
//! [`Framing::join`]: wm_model::Framing::join

mod camera_view;
mod cameras;
mod joiner;
mod matcher;
mod node;
mod parameters;
mod rule;
mod tally;

pub use joiner::{JoinError, Joiner};
pub use matcher::{Arrival, DropReason, FrameDrop, Match, Matcher, Rules};
pub use node::NODE;
