use std::path::PathBuf;

use clap::Args;
use wm_model::Framing;

use crate::{DataOptions, Dataset, DatasetError};

/// Evaluation data.
#[derive(Clone, Debug, Args)]
pub struct HeldOutArgs {
    /// Data to measure on: bags, folders of bags, or folders prepared by `wm dataset`, whose validation episodes are
    /// used
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// Options of the data.
    #[command(flatten)]
    pub options: DataOptions,
    /// Folder for decoded frames and latents, reused by the next run [default: a folder for temporary files, which
    /// stays until removed]
    #[arg(long)]
    pub cache: Option<PathBuf>,
}

impl HeldOutArgs {
    /// The cache folder.
    #[must_use]
    pub fn cache(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(std::env::temp_dir)
    }

    /// Opens the data with frames of `framing`, all cameras side by side.
    ///
    /// # Errors
    /// Names an unusable file or option.
    pub fn open(&self, framing: impl Into<Framing>) -> Result<Dataset, DatasetError> {
        Dataset::held_out(&self.data, framing, &self.cache(), &self.options)
    }
}
