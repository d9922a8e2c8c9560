//! The command-line arguments that every training has.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;

use crate::recipe::Override;

/// Data, folder and recipe of a training.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Folder with the bags of the episodes.
    #[arg(long)]
    pub bags: PathBuf,
    /// Folder with held-out bags, for validation.
    #[arg(long)]
    pub held_out: Option<PathBuf>,
    /// Folder of the model: weights, recipe, checkpoint, journal, loss curve and samples. A training that was
    /// interrupted resumes from here. Several trainings may share a folder.
    #[arg(long)]
    pub out: PathBuf,
    /// Folder for decoded frames and latents; `cache` in the output folder by default.
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Recipe: tiny, paper (where the paper has this training), or a YAML file.
    #[arg(long, default_value = "tiny")]
    pub recipe: String,
    /// A setting of the recipe, as optimisation.learning_rate=1e-3; may be repeated.
    #[arg(long, value_name = "PATH=VALUE")]
    pub set: Vec<Override>,
    /// Optimiser steps, instead of the recipe's length.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Number of threads; all of the machine by default.
    #[arg(long)]
    pub threads: Option<usize>,
}

impl RunArgs {
    /// The settings that are overridden, in the order in which they apply.
    #[must_use]
    pub fn overrides(&self) -> Vec<Override> {
        let mut overrides = self.set.clone();
        overrides.extend(
            self.steps
                .map(|steps| Override::new("length", format!("{steps} steps"))),
        );
        overrides
    }

    /// Where decoded frames and latents are kept.
    #[must_use]
    pub fn cache(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| self.out.join("cache"))
    }

    /// Number of threads.
    ///
    /// # Errors
    /// If the system does not tell how many there are.
    pub fn threads(&self) -> Result<usize> {
        match self.threads {
            Some(threads) => Ok(threads),
            None => Ok(std::thread::available_parallelism()
                .context("how many threads there are")?
                .get()),
        }
    }

    /// The name that a model of one's own gets: that of its folder.
    #[must_use]
    pub fn model_name(&self) -> String {
        let name = std::path::absolute(&self.out).ok();
        let name = name.as_deref().and_then(|path| path.file_name());
        name.map_or("model".into(), |name| name.to_string_lossy().into_owned())
    }
}
