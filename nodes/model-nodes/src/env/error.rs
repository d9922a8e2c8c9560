//! The env's errors.

use thiserror::Error;
use wm_bag::BagError;
use wm_motion::actions::ActionError;

use crate::{encoder::EncoderError, predictor::PredictorError};
use wm_camera::{goal::GoalError, image_message::ImageError};
use wm_wire::latent_message::LatentError;

/// Why an episode does not begin or continue.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EnvError {
    /// More than one start, or none.
    #[error(
        "{0} of bag, image and topic are set; set exactly one, in the request or in the env's parameters"
    )]
    Starts(usize),
    /// A start that a call may not use. The reason is not given: a caller could explore the env's disk by the answers.
    #[error(
        "no episode can start from this bag or image: expected a bag, or a PNG or JPEG file, below the env's parameter \
         start_root"
    )]
    NoStart,
    /// Too many calls wait.
    #[error("{0} calls are already waiting: try again later")]
    Busy(usize),
    /// An invalid offset.
    #[error("bag_offset is {0} s; expected 0 or more")]
    Offset(f64),
    /// The bag has no frame there.
    #[error("the bag {bag} has no camera frame at or after {offset_s:.3} s from its start")]
    NoFrame {
        /// The bag.
        bag: String,
        /// Where a frame was looked for \[s\].
        offset_s: f64,
    },
    /// No image arrived.
    #[error("no image arrived on {topic} within {seconds} s")]
    Silent {
        /// The camera's topic.
        topic: String,
        /// How long the env waited \[s\].
        seconds: f64,
    },
    /// An invalid name.
    #[error(
        "invalid episode_id \"{0}\"; expected 1 to 100 characters: letters, digits, \"_\", \"-\" and \".\", and no \
         \".\" at the start"
    )]
    Name(String),
    /// An unknown episode.
    #[error("there is no episode \"{name}\"; there are: {known}")]
    Unknown {
        /// What was requested.
        name: String,
        /// The open episodes.
        known: String,
    },
    /// No room.
    #[error("{0} episodes are open, which is the maximum (max_episodes); close one")]
    Full(usize),
    /// Its steps are used up.
    #[error("episode \"{name}\" has taken its {steps} steps; close it or reset it")]
    Over {
        /// The episode.
        name: String,
        /// Its steps.
        steps: u32,
    },
    /// Nothing to do, or too much.
    #[error("{0} actions; expected 1 to {max} (0 only with close)", max = crate::history::MAX_CHUNK)]
    Count(usize),
    /// The actions of the start are not in the model's action space.
    #[error(transparent)]
    Actions(ActionError),
    /// Invalid values of an action.
    #[error("action {index}: {source}")]
    Action {
        /// Which one of the call.
        index: usize,
        /// What is wrong with it.
        source: ActionError,
    },
    /// The model predicted a value that is not finite.
    #[error("step {step} of episode \"{name}\": {source}")]
    Prediction {
        /// The episode.
        name: String,
        /// Its step, from 1.
        step: u32,
        /// The latent's fault.
        source: LatentError,
    },
    /// The first frame is not a valid image.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The image file cannot be read.
    #[error("the image {path}: {source}")]
    File {
        /// The file.
        path: String,
        /// What is wrong with it.
        source: std::io::Error,
    },
    /// The first frame has no latent.
    #[error(transparent)]
    Encoder(#[from] EncoderError),
    /// The bag has no camera.
    #[error(transparent)]
    Camera(#[from] GoalError),
    /// The history before the first frame cannot be used.
    #[error(transparent)]
    History(#[from] PredictorError),
    /// A bag that cannot be read or written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The model cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
}

impl EnvError {
    /// The answer to a caller that named the file of the start. It reveals nothing about the file, except that a bag has no
    /// frame at the offset, or actions of another space.
    pub(super) fn without_file(self) -> Self {
        match self {
            Self::File { .. }
            | Self::Image(_)
            | Self::Bag(_)
            | Self::Camera(_)
            | Self::History(_) => Self::NoStart,
            other => other,
        }
    }
}
