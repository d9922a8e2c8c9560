//! The predictor's errors.

use thiserror::Error;
use wm_motion::actions::ActionError;

use crate::history::HistoryError;
use wm_wire::latent_message::LatentError;

/// Why an input is dropped, or a rollout ends.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum PredictorError {
    /// A latent message that cannot be used, or a predicted latent that is not finite.
    #[error(transparent)]
    Latent(#[from] LatentError),
    /// A frame, action or chunk that is dropped.
    #[error(transparent)]
    History(#[from] HistoryError),
    /// Actions that cannot be encoded for the model.
    #[error(transparent)]
    Action(#[from] ActionError),
    /// The model cannot compute it.
    #[error(transparent)]
    Model(#[from] wm_model::Error),
}
