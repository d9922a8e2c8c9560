//! What is judged.

use image::RgbImage;

/// A video of a robot, real or imagined, and what the robot was told.
#[derive(Clone, Debug)]
pub struct Rollout {
    /// What the robot was told.
    pub instruction: String,
    /// What counts as half a success; without them there is none.
    pub partial_criteria: Option<String>,
    /// The whole video, in the order of time.
    pub frames: Vec<RgbImage>,
    /// Which of the rollouts with this instruction. Even two that look alike are asked about apart.
    pub trial: u64,
    /// When it was made, or whatever the record should say.
    pub stamp_ns: u64,
}

impl Rollout {
    /// The first trial, without criteria of half a success.
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
