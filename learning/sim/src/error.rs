use crate::world::EndEffectorAction;

/// Errors of the simulator.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid number of frames.
    #[error("expected {} to {} frames per episode, got {frames}", .possible.start(), .possible.end())]
    Frames {
        /// What was requested.
        frames: usize,
        /// The valid range.
        possible: std::ops::RangeInclusive<usize>,
    },
    /// An invalid share of failures.
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
        /// Number of episodes.
        episodes: u64,
    },
    /// An unknown kind of goal.
    #[error("expected a task, one of reach, push and pick-place, got {got:?}")]
    GoalKind {
        /// What was given.
        got: String,
    },
    /// An action with values that are not finite.
    #[error(
        "expected seven finite numbers as an action (m, rad, gripper), got {:?} {:?} {}",
        .action.translation.as_slice(), .action.rotation.as_slice(), .action.gripper
    )]
    Action {
        /// What was given.
        action: EndEffectorAction,
    },
    /// A seed without a goal that the arm can attain.
    #[error(
        "expected a task of {kind} that can be solved from seed {seed}, got none in {tables} tables"
    )]
    Unsolvable {
        /// Name of the requested kind of goal.
        kind: &'static str,
        /// The seed.
        seed: u64,
        /// Number of tables tried.
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
