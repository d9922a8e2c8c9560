use crate::world::EndEffectorAction;

/// Errors of the simulator.
#[expect(missing_docs, reason = "the error texts describe variants and fields")]
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    #[error("expected {} to {} frames per episode, got {frames}", .possible.start(), .possible.end())]
    Frames {
        frames: usize,
        possible: std::ops::RangeInclusive<usize>,
    },
    #[error("expected a share of {of} from 0 to 1, got {share}")]
    Share { of: &'static str, share: f64 },
    #[error(
        "{episodes} episodes from seed {first_seed} on run past the largest seed, {}",
        u64::MAX
    )]
    Seeds { first_seed: u64, episodes: u64 },
    #[error("expected a task, one of reach, push and pick-place, got {got:?}")]
    GoalKind { got: String },
    #[error("expected goals for the policies, got none")]
    NoGoal,
    #[error(
        "expected a policy, one of oracle, frozen-gripper, random, hold, noise-N or beside-N of 1 to 200 mm, or \
         distracted-N, slow-N or stop-N of 1 to 99 %, got {got:?}"
    )]
    Policy { got: String },
    #[error(
        "expected seven finite numbers as an action (m, rad, gripper), got {:?} {:?} {}",
        .action.translation.as_slice(), .action.rotation.as_slice(), .action.gripper
    )]
    Action { action: EndEffectorAction },
    #[error(
        "expected a task of {kind} that can be solved from seed {seed}, got none in {tables} tables"
    )]
    Unsolvable {
        /// Name of the requested kind of goal.
        kind: &'static str,
        seed: u64,
        tables: usize,
    },
    /// A bag that cannot be written.
    #[error(transparent)]
    Bag(#[from] wm_bag::BagError),
    /// The description of the action space cannot be written.
    #[error(transparent)]
    Actions(#[from] wm_motion::actions::ActionError),
    #[error("cannot write {}", .path.display())]
    File {
        path: std::path::PathBuf,
        source: std::io::Error,
    },
    #[error("cannot encode a picture: {0}")]
    Picture(#[from] image::ImageError),
}
