//! What an evaluation found, and how it is told: figures, a report, comparisons, model cards.
//!
//! | what | for whom |
//! | --- | --- |
//! | [`json`] | programs: figures with intervals, what is absent and why, comparisons |
//! | [`csv`] | spreadsheets: a row per model and figure |
//! | [`html`] | people: one file with figures, curves, paths and pictures |
//! | [`model_card`] | people who are to decide whether to use a model |
//! | [`ClosedLoop`] | how often a planner succeeds on an arm |
//! | [`compare`] | whether one model is better than another, over the same units |
//!
//! Nothing here measures, reads or writes a file. Equal findings give equal bytes: no time, no random name, no order of a
//! hash table. A figure that is not finite is never printed; it is told as absent.
//!
//! ```
//! use crate::findings::{Better, Header, Metric, ModelFindings, Section, Suite};
//!
//! let mut control = Section::new(Suite::Control);
//! control.metric("cem_k1_error", Metric::plain(0.084, 20, Better::Lower, "Error of planned actions."));
//! let findings = ModelFindings {
//!     header: Header {
//!         model: "tiny".into(),
//!         hash: "00".repeat(32),
//!         space: "vae".into(),
//!         data: vec!["bridge_test".into()],
//!         data_digest: "11".repeat(32),
//!         episodes: 20,
//!         left_out: Vec::new(),
//!         seed: 0,
//!         settings: serde_json::json!({"steps": 8}),
//!         sampler: serde_json::json!({"steps": 10}),
//!         readers: Default::default(),
//!         version: "0.1.0".into(),
//!     },
//!     sections: vec![control],
//! };
//! assert!(crate::findings::csv(&[findings.clone()]).contains("control.cem_k1_error,0.084"));
//! let report = crate::findings::html("tiny on Bridge", &[findings])?;
//! assert!(report.contains("Do predictions obey the actions?"));
//! # Ok::<(), crate::findings::FindingsError>(())
//! ```

mod card;
mod closed_loop;
mod comparison;
mod csv;
mod error;
mod headlines;
mod html;
mod json;
mod model_findings;
mod number;
mod section;
mod suite;

pub use card::{CardAbout, model_card};
pub use closed_loop::{ClosedLoop, Episode, Percentiles, PlanTime};
pub use comparison::{Comparison, Difference, Verdict, compare, compare_with_first};
pub use csv::csv;
pub use error::{FindingsError, Mismatch};
pub use html::html;
pub use json::json;
pub use model_findings::{Header, ModelFindings};
pub use section::{
    Absent, Better, Curve, Metric, Picture, Section, Series, TextTable, Trajectories,
};
pub use suite::Suite;
