//! Vision-language models as judges of rollouts, over an OpenAI-compatible endpoint (`POST {base_url}/chat/completions`) as
//! offered by vLLM, SGLang, llama.cpp, Ollama and OpenAI.
//!
//! | Module | Content |
//! |---|---|
//! | [`prompts`] | the paper's prompts |
//! | [`tasks`] | the paper's tasks of Bridge V2 |
//! | [`frames`] | the frames of a video shown to a judge |
//! | [`verdict`] | parsing of answers |
//! | [`endpoint`] | a server: settings, retries, rates |
//! | [`record`] | all answers, on disk |
//! | [`rollout`] | a rollout to judge |
//! | [`judge`] | one judge |
//! | [`panel`] | several judges, from one file |
//!
//! ```no_run
//! use std::{path::Path, sync::Arc};
//! use wm_evaluation::judges::{Panel, PanelSettings, Prompts, Record, Rollout};
//!
//! # fn main() -> wm_evaluation::judges::Result<()> {
//! # let frames = Vec::new();
//! let settings = PanelSettings::read(Path::new("judges.yaml"))?;
//! let mut panel = Panel::new(settings, Arc::new(Prompts::paper()?))?;
//! let mut record = Record::open(Path::new("answers.jsonl"))?;
//! let rollouts = [Rollout::new("close oven", frames)];
//! let ratings = panel.success(&rollouts, &mut record, |done| println!("{done:?}"))?;
//! for (judge, scores) in ratings.judges.iter().zip(&ratings.scores) {
//!     println!("{judge}: {scores:?}");
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Guarantees
//! - An answer is on disk before it is returned, and its question is never sent again.
//! - An API key comes from the environment and goes into one header only. It is redacted from quotes of servers, unless it is
//!   shorter than eight characters, which no secret is.
//! - Texts of servers are bounded, and quoted without control characters.
//! - Proxies of the environment are ignored, and redirections are not followed.
//!
//! # Limits
//! It has no model and no picture metric. Agreement, consensus and ranks are in `wm_metrics`. Questions are sent one at a time.
//! It makes no frames with distractors, though it has the paper's prompt for an image editor. Costs are computed from the
//! token counts of answers; charges for broken-off requests are unknown.
//! here.

mod error;
mod excerpt;
mod text_file;

pub mod endpoint;
pub mod frames;
pub mod judge;
pub mod panel;
pub mod prompts;
pub mod record;
pub mod rollout;
pub mod tasks;
pub mod verdict;

pub use endpoint::EndpointSettings;
pub use error::{Error, Result};
pub use frames::FrameChoice;
pub use judge::{Judge, Judgement};
pub use panel::{Panel, PanelSettings, Progress, Ratings};
pub use prompts::Prompts;
pub use record::Record;
pub use rollout::Rollout;
pub use tasks::Tasks;
pub use verdict::{RubricScores, SuccessScore};
