use std::{net::TcpListener, path::PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use wm_dataset::DataOptions;
use wm_model::Compute;

use crate::arguments::{HeldOutLatentArgs, LatentRunArgs};

/// Train the transition model on bags, with the latents of a frozen encoder
#[derive(Clone, Debug, Args)]
pub struct TrainTransitionArgs {
    /// Options of the training.
    #[command(flatten)]
    pub on: LatentRunArgs,
    /// Worker processes.
    #[command(flatten)]
    pub listen: ListenArgs,
}

/// Sharing of a training with worker processes.
#[derive(Clone, Debug, Default, Args)]
pub struct ListenArgs {
    /// Share each step of the transition model with worker processes (`wm train worker`) that connect to this address,
    /// such as 127.0.0.1:7450. Nothing is authenticated or encrypted: use a network that you trust, or an SSH tunnel
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub listen: Option<String>,
    /// Workers to wait for before the first step; they may join and leave at any time
    #[arg(long, value_name = "N", default_value_t = 0, requires = "listen")]
    pub workers: usize,
}

impl ListenArgs {
    /// Checks the address early, before data and earlier parts.
    ///
    /// # Errors
    /// If it cannot be listened on.
    pub fn check(&self) -> Result<()> {
        if let Some(address) = &self.listen {
            TcpListener::bind(address).with_context(|| format!("--listen {address}"))?;
        }
        Ok(())
    }
}

/// Compute a share of each step of a training on another process or machine, `wm train transition --listen`, from the
/// same data. It needs no recipe, and writes only its cache
#[derive(Clone, Debug, Args)]
pub struct TrainWorkerArgs {
    /// Address of the training
    #[arg(value_name = "HOST:PORT")]
    pub address: String,
    /// The training's data: bags, folders of bags, or folders prepared by `wm dataset`
    #[arg(long, visible_alias = "bags", required = true, num_args = 1.., value_name = "PATH")]
    pub data: Vec<PathBuf>,
    /// Options of the data, as in the training.
    #[command(flatten)]
    pub options: DataOptions,
    /// The training's encoder: tiny, or a model's folder
    #[arg(long, visible_alias = "autoencoder")]
    pub encoder: String,
    /// Folder for decoded frames and latents [default: a folder for temporary files, which stays until removed]
    #[arg(long)]
    pub cache: Option<PathBuf>,
    /// Number of threads [default: all of the machine]. On a GPU, the batches computed in parallel [default: 1]
    #[arg(long)]
    pub threads: Option<usize>,
    /// Device: cpu, cuda or cuda:N; a GPU needs the cargo feature `cuda`
    #[arg(long, default_value = "cpu")]
    pub device: Compute,
    /// How long to wait for the training \[s\], at the start and after a lost connection
    #[arg(long, value_name = "SECONDS", default_value_t = 60)]
    pub wait: u64,
}

/// Evaluate a trained transition model on held-out bags
#[derive(Clone, Debug, Args)]
pub struct EvaluateTransitionArgs {
    /// Evaluation data.
    #[command(flatten)]
    pub on: HeldOutLatentArgs,
    /// Weights of the transition model
    #[arg(long)]
    pub weights: PathBuf,
    /// Most windows
    #[arg(long, default_value_t = usize::MAX)]
    pub windows: usize,
    /// Other numbers of Euler steps
    #[arg(long, value_delimiter = ',')]
    pub sampling_steps: Vec<usize>,
    /// Number of one-step plans from zero, for the recovery of true actions
    #[arg(long, default_value_t = 24)]
    pub plans: usize,
}
