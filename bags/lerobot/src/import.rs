//! A dataset's episodes as bags.

mod bag;
mod episode;

use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use wm_bag::Shard;
use wm_motion::actions::{ActionError, ActionSpace};

use crate::{
    LeRobotError,
    dataset::{Dataset, Entry},
    info::ACTION,
};

/// How episodes are imported.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// The numbers of the episodes to import; none imports all.
    pub episodes: Option<RangeInclusive<i64>>,
    /// Import only every Nth of these: several machines share an import.
    pub shard: Shard,
    /// JPEG quality of the frames of videos, 1 to 100. Pictures that are kept as files are taken over as they are.
    pub jpeg_quality: u8,
    /// Stamp of the first frame of each episode, in ns since the epoch; LeRobot keeps no time of day. Episodes that were
    /// exported here keep their own.
    pub start_ns: u64,
    /// Action space of the dataset. None: Bridge V2's if the names are Bridge V2's; else the bags have no action space.
    pub action_space: Option<ActionSpace>,
}

impl Default for ImportOptions {
    fn default() -> Self {
        let bridge = wm_import::ImportOptions::default();
        Self {
            episodes: None,
            shard: Shard::WHOLE,
            jpeg_quality: bridge.jpeg_quality,
            start_ns: bridge.start_ns,
            action_space: None,
        }
    }
}

/// Imports a LeRobot dataset of version v2.1 or v3.0: each episode becomes a bag `OUT/episode_NNNNNN` with its number.
/// Gives the bags, in order; a shard may have none.
///
/// Each notes where it came from, `DATASET#NUMBER` ([`wm_bag::ORIGIN`]).
///
/// Stamps are `start + frame_index / fps`, to the nanosecond; the `timestamp` of each row is held against that.
///
/// # Errors
/// A file is missing, damaged, or does not hold what `meta` says (the error names it and the field); a number is not
/// finite; there is no episode of the numbers; or a bag already exists there.
pub fn import(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<Vec<PathBuf>, LeRobotError> {
    let dataset = Dataset::open(src)?;
    let other = dataset.info.features.iter().filter(|(name, feature)| {
        !(feature.is_video() || feature.is_image() || episode::is_read(name))
    });
    let other: Vec<&str> = other.map(|(name, _)| name.as_str()).collect();
    if !other.is_empty() {
        tracing::warn!(
            features = other.join(", "),
            "ignored, because they have no corresponding topic"
        );
    }
    let actions = actions(&dataset, options.action_space.as_ref())?;
    let is_wanted = |entry: &&Entry| {
        let wanted = options.episodes.as_ref();
        wanted.is_none_or(|wanted| wanted.contains(&entry.index))
    };
    let wanted: Vec<&Entry> = dataset.episodes.iter().filter(is_wanted).collect();
    if wanted.is_empty() {
        return Err(LeRobotError::Nothing(format!(
            "{} has {} episodes, but none of those that you asked for",
            src.display(),
            dataset.episodes.len()
        )));
    }
    let own = wanted.into_iter().enumerate();
    let own = own.filter(|(number, _)| options.shard.has(*number));
    let mut bags = Vec::new();
    for (_, entry) in own {
        let episode = episode::read(&dataset, entry, options.jpeg_quality)?;
        let path = out.join(format!("episode_{:06}", entry.index));
        let start_ns = entry.start_ns.unwrap_or(options.start_ns);
        let origin = wm_import::origin(src, None, Some(entry.index));
        bag::write(&episode, actions.as_ref(), &path, start_ns, origin)?;
        tracing::info!(episode = entry.index, bag = %path.display(), frames = entry.length, "imported");
        bags.push(path);
    }
    Ok(bags)
}

/// Action space of the dataset, if known.
fn actions(
    dataset: &Dataset,
    given: Option<&ActionSpace>,
) -> Result<Option<ActionSpace>, LeRobotError> {
    let Some(feature) = dataset.info.features.get(ACTION) else {
        return Ok(None);
    };
    let names = feature.value_names();
    if let Some(space) = given {
        if space.len() != names.len() {
            return Err(ActionError::Mismatch {
                expected: format!("the action space given is {space}"),
                actual: format!("the dataset has {}", names.join(" ")),
            }
            .into());
        }
        return Ok(Some(space.clone()));
    }
    let bridge = ActionSpace::bridge();
    let dimensions = bridge.dimensions().iter();
    if dimensions.map(|dimension| &dimension.name).eq(&names) {
        return Ok(Some(bridge));
    }
    tracing::warn!(
        actions = names.join(" "),
        "nothing says what these values are, so the bags do not say it either, and training would take seven values for \
         Bridge V2's: describe them with --action-space"
    );
    Ok(None)
}
