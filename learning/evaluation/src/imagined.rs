//! Whether success in imagination ranks policies as success on the arm does (`wm eval imagined`): the value of a world
//! model for choosing between policies without a robot.
//!
//! Scripted policies of graded quality act from the same starts, in the simulator and in the world model. They act on
//! the simulator's state, without vision. The world model gets two observed pictures and then only the commands, and
//! imagines the episode. Programs, such as learned policies, see pictures: on the arm the camera's, in imagination the
//! predicted ones. The model's success probe judges the imagined latents and, for comparison, those of the true
//! pictures. The errors on true pictures are the probe's; the rest are the world model's.
//!
//! [`policy`](crate::policy) judges a single policy on recorded starts, without a true outcome.

mod arguments;
mod candidate;
mod correlation;
mod findings;
mod start;

#[cfg(test)]
mod tests;

pub use arguments::ImaginedArgs;
