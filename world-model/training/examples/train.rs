//! Trains the autoencoder: `cargo run --release -p wm_training --example train -- autoencoder --data BAGS --out RUN`.

use std::{error::Error, path::PathBuf};

use clap::{Parser, Subcommand};
use wm_model::Autoencoder;
use wm_training::autoencoder::{TrainAutoencoderArgs, evaluate_bags};

#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Trains the autoencoder.
    Autoencoder(TrainAutoencoderArgs),
    /// Measures an autoencoder on bags.
    Evaluate {
        /// Weights.
        #[arg(long)]
        weights: PathBuf,
        /// Bags.
        #[arg(long)]
        data: PathBuf,
        /// Folder for decoded frames.
        #[arg(long)]
        cache: PathBuf,
        /// Frames at most.
        #[arg(long, default_value_t = 500)]
        frames: usize,
    },
}

fn main() -> Result<(), Box<dyn Error>> {
    tracing_subscriber::fmt().with_max_level(tracing::Level::INFO).init();
    match Cli::parse().command {
        Command::Autoencoder(args) => args.run()?,
        Command::Evaluate {
            weights,
            data,
            cache,
            frames,
        } => println!("{}", evaluate_bags(&Autoencoder::open(weights)?, &data, &cache, frames)?),
    }
    Ok(())
}
