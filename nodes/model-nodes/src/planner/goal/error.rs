//! Why there is no such goal.

use thiserror::Error;
use wm_camera::image_message::ImageError;
use wm_msgs::InvalidNanoseconds;
use wm_wire::latent_message::LatentError;

use super::MOST_LATENTS;
use crate::encoder::EncoderError;

/// Why a message is no goal.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GoalError {
    /// A stamp or a time whose nanoseconds are a second or more.
    #[error("stamp or time of {0}")]
    Time(#[from] InvalidNanoseconds),
    /// A picture that has no latent.
    #[error("picture {index}: {source}")]
    Picture {
        /// Which one, from 0.
        index: usize,
        /// Why not.
        source: EncoderError,
    },
    /// A latent that cannot be used.
    #[error("latent {index}: {source}")]
    Latent {
        /// Which one, from 0.
        index: usize,
        /// Why not.
        source: LatentError,
    },
    /// Nothing says what to reach.
    #[error("it has no images, no latents and no instruction; expected one of them at least")]
    Empty,
    /// Two different things to reach.
    #[error("it has {images} images and {latents} latents; expected one of these kinds")]
    Both {
        /// Number of images.
        images: usize,
        /// Number of latents.
        latents: usize,
    },
    /// Too much to keep.
    #[error("it has {0} images or latents; at most {MOST_LATENTS} are taken")]
    TooMany(usize),
    /// Times that do not fit.
    #[error(
        "it has {times} times for {goals} images or latents; expected none, or one for each, ascending from 0"
    )]
    Times {
        /// Number of times.
        times: usize,
        /// Number of images or latents.
        goals: usize,
    },
    /// A mask that is none.
    #[error("mask: {0}")]
    Mask(#[from] ImageError),
    /// A mask that cannot be placed in the encoder's picture.
    #[error("mask: {0}")]
    MaskPlace(#[from] wm_model::Error),
    /// A mask of nothing.
    #[error(
        "the mask is 0 everywhere in the part of the picture that the model sees: nothing would count"
    )]
    NothingMarked,
    /// Words without a probe that reads them.
    #[error(
        "it has an instruction, which needs a model with a success probe and success_weight above 0"
    )]
    Words,
    /// Words that the probe cannot read.
    #[error("instruction: {0}")]
    Instruction(#[from] wm_zoo::Error),
}
