//! Between a robot's actions in physical units and the vectors that the transition model is conditioned on.
//!
//! An [`ActionSpace`] describes what the values of an action are: names, units and kinds, 1 to 32 of them; Bridge V2's
//! seven are the default. A model action belongs to one *model step*, which spans [`ActionEncoding::frame_skip`]
//! intervals of the space's rate: what happens in each interval is scaled and clipped, and the model's rule
//! ([`Accumulation`]) makes one vector of them, padded with zeros.
//!
//! What happens in an interval is [`crate::motion`]'s to say.

mod encoding;
mod error;
mod kind;
mod limits;
mod note;
mod space;
mod survey;

pub use encoding::{Accumulation, ActionEncoding, ModelAction};
pub use error::ActionError;
pub use kind::Kind;
pub use space::{ActionSpace, Dimension, MAX_DIMENSIONS};
pub use survey::{ActionSurvey, Cause, Contradiction, Hint, Range};
