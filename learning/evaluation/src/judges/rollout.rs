//! Rollouts to judge.

use image::RgbImage;

/// A video of a robot, real or imagined, with its instruction.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// Instruction of the robot.
    pub instruction: String,
    /// Criteria of half a success; without them a score is 0 or 1.
    pub partial_criteria: Option<String>,
    /// The whole video in order.
    pub frames: Vec<RgbImage>,
    /// Index among the rollouts with this instruction. Even equal rollouts are judged separately.
    pub trial: u64,
    /// Time of creation, or another stamp for the record.
    pub stamp_ns: u64,
}

impl Rollout {
    /// The first trial, without partial criteria.
    #[must_use]
    pub fn new(instruction: impl Into<String>, frames: Vec<RgbImage>) -> Self {
        Self {
            instruction: instruction.into(),
            partial_criteria: None,
            frames,
            trial: 0,
            stamp_ns: 0,
        }
    }
}
