//! What can go wrong.

use crate::environment::GoalKind;
use crate::world::EndEffectorAction;

/// Errors of the simulator.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A number of frames that no episode has.
    #[error("expected {} to {} frames per episode, got {frames}", .possible.start(), .possible.end())]
    Frames {
        /// What was requested.
        frames: usize,
        /// What can be.
        possible: std::ops::RangeInclusive<usize>,
    },
    /// A share of failures that none can be.
    #[error("expected a share of failures from 0 to 1, got {share}")]
    Share {
        /// What was requested.
        share: f64,
    },
    /// Seeds beyond the largest 64-bit number.
    #[error(
        "{episodes} episodes from seed {first_seed} on run past the largest seed, {}",
        u64::MAX
    )]
    Seeds {
        /// Seed of the first episode.
        first_seed: u64,
        /// How many.
        episodes: u64,
    },
    /// A kind of goal that there is not.
    #[error("expected a task, one of reach, push and pick-place, got {got:?}")]
    GoalKind {
        /// What was given.
        got: String,
    },
    /// An action that is not a motion.
    #[error(
        "expected seven finite numbers as an action (m, rad, gripper), got {:?} {:?} {}",
        .action.translation.as_slice(), .action.rotation.as_slice(), .action.gripper
    )]
    Action {
        /// What was given.
        action: EndEffectorAction,
    },
    /// A seed of which no goal came that the arm can attain.
    #[error(
        "expected a task of {kind} that can be solved from seed {seed}, got none in {tables} tables"
    )]
    Unsolvable {
        /// What kind of goal was wanted.
        kind: GoalKind,
        /// The seed.
        seed: u64,
        /// How many tables were tried.
        tables: usize,
    },
    /// A bag that cannot be written.
    #[error(transparent)]
    Bag(#[from] wm_bag::BagError),
    /// The description of the action space cannot be written.
    #[error(transparent)]
    Actions(#[from] wm_motion::actions::ActionError),
    /// A picture that cannot be encoded.
    #[error("cannot encode a picture: {0}")]
    Picture(#[from] image::ImageError),
}
