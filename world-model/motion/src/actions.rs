//! Physical actions of a robot, and the model actions that condition the transition model.
//!
//! An [`ActionSpace`] names the 1 to 32 values of an action with their units and kinds; Bridge V2's seven are the
//! default. A model action belongs to one *model step* of [`ActionEncoding::frame_skip`] intervals of the space's rate.
//! The motion in each interval ([`crate::motion`]) is scaled and clipped; the model's rule ([`Accumulation`]) combines
//! the intervals into one vector, padded with zeros.

mod encoding;
mod error;
mod fit;
mod kind;
mod limits;
mod metadata;
mod nominal;
mod space;
mod survey;

pub use encoding::{Accumulation, ActionEncoding, ModelAction};
pub use error::ActionError;
pub use fit::Spread;
pub use kind::Kind;
pub use space::{ActionSpace, Dimension, MAX_DIMENSIONS};
pub use survey::{ActionSurvey, Cause, Contradiction, Hint, Range, StateComparison, StateRelation};
