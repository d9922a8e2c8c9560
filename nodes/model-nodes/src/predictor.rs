//! The predictor node: latents and actions in, predicted latents out, one message per step.
//!
//! [`PredictorStep`] is the node's state without its ROS interface: it aligns frames and actions, says when and from
//! what to roll out ([`RolloutRequest`]), and scores predictions when the frame of the predicted time arrives.
//! [`RunningRollout`] computes a request, one [`wm_msgs::wm_msgs::Prediction`] after another, so that the first is sent
//! while the last is still to come. Both are deterministic: the same messages with the same stamps give the same
//! predictions.

mod ahead;
mod calibration;
mod error;
mod node;
mod plots;
mod rollout;
mod scoring;
mod step;
mod summary;
mod trial;
mod trust;

pub use calibration::{CalibrationSettings, Fit};
pub use error::PredictorError;
pub use node::NODE;
pub use rollout::{PredictedStep, RolloutRequest, RunningRollout};
use step::LatentEffect;
pub use step::{Outcome, PredictorSettings, PredictorStep};
pub use trust::{Doubt, Trust, UNLIKE, part_far_out};
