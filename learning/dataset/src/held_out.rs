use std::path::PathBuf;

use clap::Args;
use wm_model::Framing;

use crate::{DataOptions, Dataset, DatasetError};

/// What an evaluation measures on.
#[derive(Clone, Debug, Args)]
pub struct HeldOutArgs {
    /// What to measure on: bags, folders of bags, or folders that `wm dataset` prepared, of which the episodes for
    /// validation are taken.
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// How recordings become episodes.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder for decoded frames and latents, which the next run takes from there; by default the system's for temporary
    /// files, where they stay until they are removed.
    #[arg(long)]
    pub cache: Option<PathBuf>,
}

impl HeldOutArgs {
    /// Where decoded frames and latents are kept.
    #[must_use]
    pub fn cache(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(std::env::temp_dir)
    }

    /// The data, with frames as `framing` says, all cameras side by side.
    ///
    /// # Errors
    /// Names what cannot be used.
    pub fn open(&self, framing: impl Into<Framing>) -> Result<Dataset, DatasetError> {
        Dataset::held_out(&self.data, framing, &self.cache(), &self.options)
    }
}
