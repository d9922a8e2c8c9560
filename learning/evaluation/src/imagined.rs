//! Whether success in imagination ranks policies as success on the arm does (`wm eval imagined`): what a world model is worth
//! for choosing between policies without a robot.
//!
//! Scripted policies of graded quality act from the same starts, in the simulator and in the world model. What a policy does
//! follows from the state, which the simulator tells it; it has no eyes. So the world model is given two observed pictures
//! and then the commands alone, none of what became of them, and imagines the episode to its end. The model's success probe
//! judges the imagined latents, and for comparison those of the pictures that came: what the second one misses is the
//! probe's, the rest the world model's.
//!
//! [`policy`](crate::policy) judges a single policy on recorded starts, where nobody knows what would really have come of it.

mod arguments;
mod correlation;
mod findings;
mod performance;
mod scripted;
mod start;

#[cfg(test)]
mod tests;

pub use arguments::ImaginedArgs;
