//! Evaluates a policy in the imagined environment (the paper, appendix C.1, B to D): the world model shows the results
//! of its actions; a success probe and vision-language models judge the imagined episodes.
//!
//! An episode of the data with an instruction is a task. The policy starts from its first [`CONTEXT`](crate::CONTEXT)
//! frames, sees a picture, acts, and sees the predicted picture. A unit is one trial of one task; trials differ in the
//! noise seed. A task may also have another instruction or first frame ([`Condition`]); these are separate trials with
//! the same seeds.
//!
//! The policy is the recorded actions, no motion, or a program that speaks JSON lines ([`protocol`]). No robot and no
//! DDS are involved: `wm env` is the environment for policies that are nodes.

mod actor;
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

pub(crate) use actor::Actor;
pub use arguments::PolicyArgs;
pub use borda::borda_of;
pub(crate) use borda::with_borda;
pub use condition::Condition;
pub(crate) use episode::{Imagination, Start, Trial, imagine};
pub use inputs::{JudgeInputs, PolicyInputs, PolicySettings};
pub use judging::{Rubric, Verdicts};
pub(crate) use process::PolicyProcess;
pub(crate) use setup::Policy;
pub use setup::Setup;
pub use summary::summarise;
pub use trial::{ImaginedTrial, Trials};

#[cfg(test)]
mod tests;
