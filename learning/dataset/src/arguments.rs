use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use wm_bag::Shard;
use wm_model::{Encoder, Fit};
use wm_zoo::ModelFolder;

use super::{
    Data, DataOptions, Dataset, DatasetError, Size,
    data::{name_left_out, name_mixed_sizes},
    preparation::Preparation,
    search::{find, find_others},
    store::{add_latent_statistics, is_prepared, read_audit, read_manifest},
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
    /// How pictures of another aspect become pictures of this size: crop (the middle), stretch or pad (black bars). A model
    /// has one of them, and refuses pictures that were prepared with another [default: crop]
    #[arg(long, value_name = "FIT")]
    fit: Option<Fit>,
    #[command(flatten)]
    options: DataOptions,
}

#[derive(Clone, Debug, Subcommand)]
enum DatasetCommand {
    /// Show the contents of a prepared folder, its audit, and what was left out
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
        /// The model whose encoder it is: tiny, or a model's folder
        #[arg(long, visible_alias = "autoencoder")]
        encoder: String,
        /// Folder for the latents, and for smaller pictures if the encoder takes such [default: the prepared folder]
        #[arg(long)]
        cache: Option<PathBuf>,
        /// Encode only the Ith of N equal parts of the frames, counted from 0, and leave the statistics: several machines
        /// share the work, each with another I and the same folders. The same command without this joins the parts
        #[arg(long, value_name = "I/N")]
        shard: Option<Shard>,
    },
}

impl DatasetArgs {
    /// Prepares the folder and prints what is in it, or what the subcommand asks for.
    ///
    /// # Errors
    /// When options, bags or folders cannot be used: the error names the offender.
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
                        "{dir}: it is no prepared data set; make one first: wm dataset {dir} -o DATA, then wm dataset \
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
            (
                self.size.or(options.size).unwrap_or_default(),
                self.fit.or(options.fit).unwrap_or(Fit::Crop),
            ),
            options.split_rule()?,
        )?;
        preparation.write(out)?;
        let manifest = read_manifest(out)?;
        name_left_out(&manifest, out);
        let audit = read_audit(out)?;
        name_mixed_sizes(&manifest, audit.as_ref());
        println!("{manifest}");
        if let Some(audit) = audit {
            println!("{audit}");
        }
        Ok(())
    }
}

/// Adds mean and standard deviation of the latents to the folder's statistics, and prints them.
fn add_statistics(dir: &Path, latents: &Latents) -> anyhow::Result<()> {
    let statistics = latents.statistics()?;
    for (channel, (mean, std)) in (statistics.mean.iter().zip(&statistics.std)).enumerate() {
        println!("channel {channel}: mean {mean:.4}, std {std:.4}");
    }
    Ok(add_latent_statistics(dir, statistics)?)
}

/// Encodes a shard's frames, and says where they are.
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
        println!("There are too few frames for shard {shard}.");
    }
    println!("The same command without --shard joins the shards and adds the statistics.");
    Ok(())
}
