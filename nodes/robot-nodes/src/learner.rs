//! The learner: records what passes, trains in a process of its own, and gives the nodes a new model if it is better.
//!
//! - `Recording` writes bags of some seconds, with small pictures, on a thread of its own.
//! - `superfluous` chooses the bags that go if the disk's share is full.
//! - `Training` is the process `wm train round`, of low priority, bounded in memory and paused if the computer is too hot.
//! - `Schedule` decides when a round begins; it knows neither clock nor disk.

mod node;
mod parameters;
mod recording;
mod resources;
mod ring;
mod schedule;
mod training;
mod workplace;

pub use node::NODE;
use recording::{Item, Recorded, Recording, RecordingSettings};
use resources::{Resources, hottest_c};
use ring::superfluous;
use schedule::{Due, Schedule};
use training::{Training, TrainingSettings};
