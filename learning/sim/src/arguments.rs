//! The command line of `wm sim`.

use std::fs::File;
use std::io::{Cursor, Write as _};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use anyhow::Context;
use image::{ImageFormat, RgbImage};
use wm_bag::Shard;
use wm_program::progress::Progress;

use crate::dataset::generate_bags;
use crate::environment::{GoalKind, ScriptedPolicy};
use crate::episode_options::EpisodeOptions;
use crate::error::Error;

/// Objects that `--distractors` adds to a picture.
const DISTRACTORS: usize = 2;

/// Make Bridge-style bags of a simulated arm on a tabletop, one bag per episode.
#[derive(Clone, Debug, clap::Args)]
pub struct SimArgs {
    /// Number of episodes
    #[arg(long, default_value_t = 1)]
    pub episodes: u64,
    /// Seed of the first episode; each later episode adds 1. The same seed makes the same bag
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Frames per episode, at 5 Hz
    #[arg(long, default_value_t = 50)]
    pub frames: usize,
    /// Also write masks of the gripper and the objects on /camera/mask/compressed, and the objects' names on
    /// /camera/mask/label_info
    #[arg(long)]
    pub masks: bool,
    /// Share of failed episodes, 0 to 1: a missed grasp, a dropped object, the wrong place, the wrong object, or a stop
    /// halfway. If it is not 0, every episode has one task
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub failures: f64,
    /// Demonstrate the tasks of `wm eval control --task` (reach, push, pick-place), one after another, by the simulator's
    /// own controller instead of an operator
    #[arg(
        long,
        value_name = "TASK",
        value_delimiter = ',',
        conflicts_with = "failures"
    )]
    pub goals: Vec<GoalKind>,
    /// Largest share of the demonstrated actions that are disturbed, 0 to 1; each episode draws its own. They show the way
    /// back
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, requires = "goals")]
    pub disturbance: f64,
    /// Let one of these policies act in each episode, drawn by its seed, for one task from the starts of
    /// `wm eval control`: oracle (the simulator's own controller), noise-MM, distracted-PERCENT, beside-MM, slow-PERCENT,
    /// stop-PERCENT, frozen-gripper, random or hold. Without names, the 16 of `wm eval imagined`
    #[arg(
        long,
        value_name = "NAME",
        num_args = 0..,
        value_delimiter = ',',
        requires = "goals",
        conflicts_with_all = ["failures", "disturbance"]
    )]
    pub policies: Option<Vec<ScriptedPolicy>>,
    /// Also write each episode's first picture with two more objects, which the task does not name, as
    /// DIR/episode_000012.png: for `wm eval policy --start-images`
    #[arg(long, value_name = "DIR")]
    pub distractors: Option<PathBuf>,
    /// Make every Nth episode, from the Ith (counted from 0): run the command on several machines, each with a
    /// different I
    #[arg(long, value_name = "I/N", default_value = "0/1")]
    pub shard: Shard,
    /// Directory for the bags; created if it does not exist
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

impl SimArgs {
    /// Makes the bags and reports progress.
    ///
    /// # Errors
    /// An option is out of range, or a bag cannot be written.
    pub fn run(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the directory {}", self.out.display()))?;
        if let Some(folder) = &self.distractors {
            std::fs::create_dir_all(folder)
                .with_context(|| format!("cannot make the directory {}", folder.display()))?;
        }
        let progress = Progress::of("making", "episodes", self.shard.share_of(self.episodes));
        let options = EpisodeOptions {
            frames: self.frames,
            masks: self.masks,
            failures: self.failures,
            goals: self.goals.clone(),
            disturbance: self.disturbance,
            policies: match self.policies.as_deref() {
                None => Vec::new(),
                Some([]) => ScriptedPolicy::ALL.to_vec(),
                Some(named) => named.to_vec(),
            },
            distractors: self.distractors.as_ref().map_or(0, |_| DISTRACTORS),
            ..EpisodeOptions::default()
        };
        let succeeded = AtomicU64::new(0);
        let own = (self.episodes, self.shard);
        let bags = generate_bags(&self.out, own, self.seed, &options, |episode| {
            succeeded.fetch_add(u64::from(episode.success), Ordering::Relaxed);
            progress.inc(1);
            if let (Some(folder), Some(picture)) = (&self.distractors, &episode.distracted) {
                write_new(picture, folder.join(format!("{}.png", episode.name())))?;
            }
            Ok(())
        })
        .with_context(|| format!("cannot make the episodes in {}", self.out.display()))?;
        drop(progress);
        println!(
            "{} episodes of {} frames in {} (the task was done in {})",
            bags.len(),
            self.frames,
            self.out.display(),
            succeeded.into_inner()
        );
        Ok(())
    }
}

/// Writes a picture as a PNG that does not exist yet.
fn write_new(picture: &RgbImage, path: PathBuf) -> Result<(), Error> {
    let mut png = Cursor::new(Vec::new());
    picture.write_to(&mut png, ImageFormat::Png)?;
    File::create_new(&path)
        .and_then(|mut file| file.write_all(png.get_ref()))
        .map_err(|source| Error::File { path, source })
}
