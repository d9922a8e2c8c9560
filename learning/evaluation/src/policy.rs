//! A policy in the imagined environment (the paper, appendix C.1, B to D): the world model shows it what comes of its
//! actions, and a success probe and vision-language models judge the imagined episodes.
//!
//! An episode of the data with an instruction is a task. Its first [`CONTEXT`](crate::CONTEXT) frames are observed; from there
//! on a policy sees a picture, acts, and sees the picture that the world model predicts. A unit is one trial of one task:
//! trials differ in the seed of the noise. Beside the recorded instruction and frames a task may have another instruction
//! or another first frame ([`Condition`]); those are trials of their own, with the same seeds.
//!
//! The policy is the recorded actions, no motion, or a program that speaks JSON lines ([`protocol`]). No robot and
//! no DDS: `wm env` is the environment for policies that are nodes.

mod arguments;
mod borda;
mod condition;
mod episode;
mod inputs;
mod judging;
mod process;
pub mod protocol;
mod setup;
mod start_images;
mod summary;
mod tasks;
mod trial;
mod words;

pub use arguments::PolicyArgs;
pub use borda::borda_of;
pub(crate) use borda::with_borda;
pub use condition::Condition;
pub use inputs::{JudgeInputs, PolicyInputs, PolicySettings};
pub use judging::{Rubric, Verdicts};
pub use setup::Setup;
pub use summary::summarise;
pub use trial::{Imagined, Trials};

#[cfg(test)]
mod tests;
