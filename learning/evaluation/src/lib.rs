//! Measures a world model on recordings by the paper's protocols (section 4.2, appendix C).
//!
//! A [`Subject`] is a model with its evaluation data. A suite (`fidelity`, `control`, `representation`,
//! [`policy`], `robustness`, `cost`) has units (an episode, a window), measures each alone, and makes findings from
//! the results, without the model. So units are spread over threads, processes and machines, stored in [`records`], and
//! merged ([`run`]).
//!
//! Formulas and reports are in `wm_metrics`.

mod accuracy;
mod action_correlation;
mod arguments;
mod calibrate;
pub mod card;
mod closed_loop;
mod control;
mod cost;
mod families;
mod fidelity;
mod figure;
mod figures;
mod imagined;
pub mod judges;
mod merge;
pub mod onnx;
mod output;
mod paper;
mod perception;
mod picture_strip;
mod pictures;
pub mod policy;
mod readers;
pub mod records;
mod recovery;
mod representation;
mod robustness;
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
pub use families::FamilyArg;
pub use figure::Figure;
pub use figures::spread;
pub use imagined::ImaginedArgs;
pub use merge::MergeArgs;
pub(crate) use output::OutputArgs;
pub use paper::PaperArgs;
pub(crate) use perception::{Perception, PerceptionArgs};
pub use picture_strip::grid;
pub use pictures::PictureErrors;
pub use policy::PolicyArgs;
pub(crate) use readers::{Reader, ReaderArgs, Readers};
pub use recovery::{Recovery, recover_actions};
pub use settings::{Protocol, Settings};
pub use squared_error::SquaredError;
pub use strip::strip;
pub use subject::Subject;
pub(crate) use subject::open_model;
pub use windows::{ActionChange, CONTEXT, Windows, squared};
pub use wm_bag::Shard;
