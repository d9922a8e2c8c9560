//! Measures a world model on recordings by the paper's protocols (section 4.2, appendix C).
//!
//! A [`Subject`] is a model with the data that it is measured on. A suite ([`fidelity`], [`control`], [`representation`],
//! [`policy`], [`robustness`], [`cost`]) has units (an episode, a window), measures each by itself, and makes findings of
//! what was measured: of the units alone, without the model. So units are spread over threads, processes and machines, kept
//! in [`records`], and merged ([`run`]).
//!
//! Not here: what the findings look like and the figures' formulas (`wm_metrics`).

mod accuracy;
mod action_correlation;
mod arguments;
mod calibrate;
pub mod card;
mod closed_loop;
pub mod control;
pub mod cost;
pub mod fidelity;
mod figure;
mod figures;
mod imagined;
pub mod judges;
mod merge;
pub mod onnx;
mod output;
pub mod perception;
mod picture_strip;
mod pictures;
pub mod policy;
mod readers;
pub mod records;
mod recovery;
pub mod representation;
pub mod robustness;
pub mod run;
mod settings;
mod squared_error;
mod strip;
mod subject;
mod windows;

pub use accuracy::Accuracy;
pub use action_correlation::{Correlation, on_clips, on_predicted, on_real};
pub use arguments::SuiteArgs;
pub use calibrate::CalibrateArgs;
pub use closed_loop::ClosedLoopArgs;
pub use figure::Figure;
pub use figures::spread;
pub use imagined::ImaginedArgs;
pub use merge::MergeArgs;
pub use output::OutputArgs;
pub use perception::{Perception, PerceptionArgs};
pub use picture_strip::grid;
pub use pictures::{PictureErrors, StepErrors};
pub use policy::{PolicyArgs, PolicySettings};
pub use readers::{Reader, ReaderArgs, Readers};
pub use recovery::{Recovery, recover_actions};
pub use settings::{
    ControlSettings, FidelitySettings, LatentsSettings, Protocol, RobustnessSettings,
    SearchSettings, Settings,
};
pub use squared_error::SquaredError;
pub use strip::strip;
pub use subject::{Recording, Subject, open_model};
pub use windows::{ActionChange, CONTEXT, Windows, squared};
pub use wm_bag::Shard;
