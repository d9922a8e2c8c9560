//! Results of evaluations, and their output: figures, reports, comparisons, model cards.
//!
//! | item | purpose |
//! | --- | --- |
//! | [`json`] | for programs: figures with intervals, missing figures with reasons, comparisons |
//! | [`csv`] | for spreadsheets: one row per model and figure |
//! | [`html`] | for people: one file with figures, curves, paths and pictures |
//! | [`model_card`] | for people who choose a model |
//! | [`paper_page`] | for readers of the paper: its quantities, filled |
//! | [`ClosedLoop`] | success rate of a planner on an arm |
//! | [`family`] | the mean of several models, to compare families |
//! | [`compare`] | whether one model is better than another over the same units |
//!
//! Nothing here measures or accesses files. Equal findings give equal bytes. Figures that are not finite are reported
//! as missing, never printed.
//!
//! ```
//! use wm_metrics::findings::{Better, Header, Metric, ModelFindings, Section, Suite};
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
//! assert!(wm_metrics::findings::csv(&[findings.clone()]).contains("control.cem_k1_error,0.084"));
//! let report = wm_metrics::findings::html("tiny on Bridge", &[findings])?;
//! assert!(report.contains("Do predictions obey the actions?"));
//! # Ok::<(), wm_metrics::findings::FindingsError>(())
//! ```

mod card;
mod closed_loop;
mod comparison;
mod csv;
mod error;
mod family;
mod headlines;
mod html;
mod json;
mod model_findings;
mod number;
mod paper;
mod section;
mod suite;

pub use card::{CardDetails, model_card};
pub use closed_loop::{ClosedLoop, Episode, Percentiles, PlanTime};
pub use comparison::{Comparison, Difference, Verdict, compare, compare_with_first};
pub use csv::csv;
pub use error::{FindingsError, Mismatch};
pub use family::family;
pub use html::html;
pub use json::json;
pub use model_findings::{Header, ModelFindings};
pub use paper::paper_page;
pub use section::{
    AbsentFigure, Better, Curve, Metric, Picture, Section, Series, TextTable, Trajectories,
};
pub use suite::Suite;
