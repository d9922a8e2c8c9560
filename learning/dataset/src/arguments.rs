use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use wm_bag::Shard;
use wm_model::{Encoder, Fit};
use wm_zoo::ModelFolder;

use super::{
    Data, DataOptions, Dataset, DatasetError, Size,
    data::{log_exclusions, log_mixed_sizes},
    preparation::Preparation,
    scales::remark,
    search::{find, find_others},
    store::{ACTION_SPACE, Folder, add_latent_statistics, is_prepared, read_audit, read_manifest},
};
use crate::Latents;

/// Prepare bags for training: cut them into episodes, resample them to the rate of their action space, and split them
/// into training and validation
#[derive(Args, Clone, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct DatasetArgs {
    #[command(subcommand)]
    command: Option<DatasetCommand>,
    /// Bags: folders with metadata.yaml, .mcap files, or folders to search for bags
    #[arg(required = true, value_name = "BAG")]
    bags: Vec<PathBuf>,
    /// Folder to create; it must not exist
    #[arg(short, long, required = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Height and width of a camera's pictures [default: 128x128]
    #[arg(long, value_name = "HxW")]
    size: Option<Size>,
    /// How pictures of another aspect fit this size: crop (the middle), stretch or pad (black bars). A model requires
    /// the fit it was trained with [default: crop]
    #[arg(long, value_name = "FIT")]
    fit: Option<Fit>,
    #[command(flatten)]
    options: DataOptions,
}

#[derive(Clone, Debug, Subcommand)]
enum DatasetCommand {
    /// Show the contents of a prepared folder, its audit, and what was excluded
    Info {
        /// The folder
        dir: PathBuf,
        /// Print JSON: the manifest and the audit
        #[arg(long)]
        json: bool,
    },
    /// Encode the frames of a prepared folder, and add mean and standard deviation of the latents to its statistics
    Latents {
        /// The folder
        dir: PathBuf,
        /// Model whose encoder to use: tiny, or a model's folder
        #[arg(long, visible_alias = "autoencoder")]
        encoder: String,
        /// Folder for the latents, and for resized pictures if the encoder needs them [default: the prepared folder]
        #[arg(long)]
        cache: Option<PathBuf>,
        /// Encode only the Ith of N equal parts of the frames, counted from 0, without statistics, to share the work
        /// between machines with the same folders. Run the command without --shard to join the parts
        #[arg(long, value_name = "I/N")]
        shard: Option<Shard>,
    },
}

impl DatasetArgs {
    /// Runs the command.
    ///
    /// # Errors
    /// Names the option, bag or folder at fault.
    pub fn run(&self) -> anyhow::Result<()> {
        match (&self.command, &self.out) {
            (Some(DatasetCommand::Info { dir, json }), _) => {
                let (manifest, audit) = (read_manifest(dir)?, read_audit(dir)?);
                if *json {
                    let both = serde_json::json!({"dataset": manifest, "audit": audit});
                    println!("{both:#}");
                    return Ok(());
                }
                println!("{manifest}");
                match audit {
                    Some(audit) => println!("{audit}"),
                    None => println!("audit: none; prepare the bags again for one"),
                }
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
                    shard,
                }),
                _,
            ) => {
                if !is_prepared(dir) {
                    let dir = dir.display();
                    anyhow::bail!(
                        "{dir}: not a prepared data set; create one first: wm dataset {dir} -o DATA, then wm dataset \
                         latents DATA"
                    );
                }
                let encoder = ModelFolder::open(encoder)?.encoder()?;
                let cache = cache.as_ref().unwrap_or(dir);
                let options = DataOptions::default();
                let paths = [dir.clone()];
                let data = Data::open(&paths, encoder.framing(), cache, &options)?;
                match shard {
                    Some(shard) => encode_shard(&data.training, &*encoder, cache, *shard),
                    None => add_statistics(dir, &Latents::open(&data.training, &*encoder, cache)?),
                }
            }
            (None, Some(out)) => Ok(self.prepare(out)?),
            // Clap requires one of both.
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
            (
                self.size.or(options.size).unwrap_or_default(),
                self.fit.or(options.fit).unwrap_or(Fit::Crop),
            ),
            options.split_rule()?,
        )?;
        preparation.write(out)?;
        let manifest = read_manifest(out)?;
        log_exclusions(&manifest, out);
        let audit = read_audit(out)?;
        log_mixed_sizes(&manifest, audit.as_ref());
        println!("{manifest}");
        if let Some(audit) = audit {
            println!("{audit}");
        }
        let folder = Folder::open(out)?;
        let (space, file) = (&manifest.action_space, out.join(ACTION_SPACE));
        let remark = remark(space, folder.all_episodes(), &file);
        if let Some(remark) = remark.map_err(DatasetError::of_scales)? {
            println!("{remark}");
        }
        Ok(())
    }
}

/// Writes the latents' mean and standard deviation to the folder's statistics, and prints them.
fn add_statistics(dir: &Path, latents: &Latents) -> anyhow::Result<()> {
    let statistics = latents.statistics()?;
    for (channel, (mean, std)) in (statistics.mean.iter().zip(&statistics.std)).enumerate() {
        println!("channel {channel}: mean {mean:.4}, std {std:.4}");
    }
    Ok(add_latent_statistics(dir, statistics)?)
}

/// Encodes a shard's frames, and prints their file.
fn encode_shard(
    dataset: &Dataset,
    encoder: &dyn Encoder,
    cache: &Path,
    shard: Shard,
) -> anyhow::Result<()> {
    let files = Latents::encode_shard(dataset, encoder, cache, shard)?;
    for file in &files {
        println!("{}", file.display());
    }
    if files.is_empty() {
        println!("Too few frames for shard {shard}.");
    }
    println!("Run the command without --shard to join the shards and add the statistics.");
    Ok(())
}
