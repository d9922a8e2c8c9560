use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use wm_zoo::ModelFolder;

use super::{
    Data, DataOptions, DatasetError, Size,
    data::name_left_out,
    preparation::Preparation,
    search::{find, find_others},
    store::{add_latent_statistics, is_prepared, read_manifest},
};
use crate::Latents;

/// Prepares bags for training: cuts them into episodes, resamples them to the rate of their action space, and splits them
/// into training and validation.
#[derive(Args, Clone, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct DatasetArgs {
    #[command(subcommand)]
    command: Option<DatasetCommand>,
    /// Bags: folders with metadata.yaml, .mcap files, or folders in which to search for bags
    #[arg(required = true, value_name = "BAG")]
    bags: Vec<PathBuf>,
    /// Folder to write; it must not exist
    #[arg(short, long, required = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Height and width of a camera's pictures [default: 128x128]
    #[arg(long, value_name = "HxW")]
    size: Option<Size>,
    #[command(flatten)]
    options: DataOptions,
}

#[derive(Clone, Debug, Subcommand)]
enum DatasetCommand {
    /// Say what is in a prepared folder, and what was left out
    Info {
        /// The folder
        dir: PathBuf,
    },
    /// Encode the frames of a prepared folder, and add mean and standard deviation of the latents to its statistics
    Latents {
        /// The folder
        dir: PathBuf,
        /// The model whose encoder it is: tiny, or a model's folder
        #[arg(long, visible_alias = "autoencoder")]
        encoder: String,
        /// Folder for the latents, and for smaller pictures if the encoder takes such [default: the prepared folder]
        #[arg(long)]
        cache: Option<PathBuf>,
    },
}

impl DatasetArgs {
    /// Prepares the folder and prints what is in it, or what the subcommand asks for.
    ///
    /// # Errors
    /// When options, bags or folders cannot be used: the error names the offender.
    pub fn run(&self) -> anyhow::Result<()> {
        match (&self.command, &self.out) {
            (Some(DatasetCommand::Info { dir }), _) => {
                let manifest = read_manifest(dir)?;
                println!("{manifest}");
                for left in &manifest.left_out {
                    println!("left out: {left}");
                }
                Ok(())
            }
            (
                Some(DatasetCommand::Latents {
                    dir,
                    encoder,
                    cache,
                }),
                _,
            ) => {
                let encoder = ModelFolder::open(encoder)?.encoder()?;
                let cache = cache.as_ref().unwrap_or(dir);
                let options = DataOptions::default();
                let paths = [dir.clone()];
                let data = Data::open(&paths, encoder.input_size(), cache, &options)?;
                let statistics = Latents::open(&data.training, &*encoder, cache)?.statistics()?;
                for (channel, (mean, std)) in
                    (statistics.mean.iter().zip(&statistics.std)).enumerate()
                {
                    println!("channel {channel}: mean {mean:.4}, std {std:.4}");
                }
                Ok(add_latent_statistics(dir, statistics)?)
            }
            (None, Some(out)) => Ok(self.prepare(out)?),
            // The command line requires one or the other.
            (None, None) => Ok(()),
        }
    }

    fn prepare(&self, out: &Path) -> Result<(), DatasetError> {
        let options = self.options.with_config()?;
        if out.exists() {
            return Err(DatasetError::Exists(out.to_owned()));
        }
        if let Some(dir) = self.bags.iter().find(|path| is_prepared(path)) {
            return Err(DatasetError::Prepared {
                dir: dir.clone(),
                what: "expected bags, found a data set that is prepared already".to_owned(),
            });
        }
        let preparation = Preparation::new(
            find_others(&self.bags, &options.held_out)?,
            find(&options.held_out)?,
            options.settings()?,
            self.size.or(options.size).unwrap_or_default(),
            options.split_rule()?,
        )?;
        preparation.write(out)?;
        let manifest = read_manifest(out)?;
        name_left_out(&manifest, out);
        println!("{manifest}");
        Ok(())
    }
}
