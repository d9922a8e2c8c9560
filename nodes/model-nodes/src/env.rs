//! The env node: the world model itself is the environment. Actions in, predicted camera images out.
//!
//! [`Env`] is the node without its ROS interface: episodes are [reset](Env::reset) and take [steps](Env::step) in
//! gymnasium's sense (<https://gymnasium.farama.org/api/env/>), several side by side in one batch of the transition
//! model. One step is one model step. The same start, calls and seed give the same images, alone or in a batch.
//!
//! Each episode starts from real frames; from then on the model sees only what it predicted itself (the closed loop of
//! the paper's policy evaluation, 50 steps an episode), in the sampler's sliding window. An episode that has a single
//! first frame starts as if the robot had stood still before it: the model has learned to predict from a history, never
//! from one frame.
//!
//! There is no reward: the world model has none. `terminated` of gymnasium is the client's to say, with `close`.

mod attached;
mod episode;
mod error;
mod model;
mod node;
mod parameters;
mod recording;
mod start;
mod start_root;
mod step;

pub use attached::Attached;
pub use error::EnvError;
pub use model::EnvModel;
pub use node::NODE;
pub(crate) use start::INSTRUCTION;
pub use start::Start;
pub use start_root::StartRoot;
pub use step::{Env, EnvSettings, Move, Moved, Observation};
