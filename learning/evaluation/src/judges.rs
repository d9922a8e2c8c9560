//! Vision-language models as judges of rollouts, over an OpenAI-compatible endpoint: `POST {base_url}/chat/completions`, as
//! vLLM, SGLang, the server of llama.cpp, Ollama and OpenAI speak it.
//!
//! | What | Module |
//! |---|---|
//! | What judges are asked: the paper's prompts | [`prompts`] |
//! | What rollouts are judged on: the paper's tasks of Bridge V2 | [`tasks`] |
//! | Which frames of a video they see | [`frames`] |
//! | What an answer says | [`verdict`] |
//! | A server and how it is asked: settings, retries, rates | [`endpoint`] |
//! | Every answer, on disk | [`record`] |
//! | What is judged | [`rollout`] |
//! | A judge | [`judge`] |
//! | Several, from one file | [`panel`] |
//!
//! ```no_run
//! use std::{path::Path, sync::Arc};
//! use crate::judges::{Panel, PanelSettings, Prompts, Record, Rollout};
//!
//! # fn main() -> crate::judges::Result<()> {
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
//! # What holds
//! - An answer is on the disk before it is returned, and a question that has one is not asked again.
//! - An API key comes from the environment, goes into one header, and is in no message and no record: where a server quotes
//!   it, it is taken out. Of keys under eight characters, which no secret has, that is not done.
//! - What servers send is bounded, and quoted without control characters.
//! - Proxies that the environment names are not used, and redirections are not followed.
//!
//! # What it does not do
//! It has no model, and no metric of pictures. It does not aggregate: agreement, consensus and ranks are `wm_metrics`'.
//! It asks one question at a time. It makes no frames with distractors, though it has the paper's words for an image editor.
//! Money is counted by what servers say of their answers; what a server bills for a request that broke off is not known
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
pub use judge::{Judge, Judged};
pub use panel::{Panel, PanelSettings, Progress, Ratings};
pub use prompts::Prompts;
pub use record::Record;
pub use rollout::Rollout;
pub use tasks::Tasks;
pub use verdict::{RubricScores, SuccessScore};
