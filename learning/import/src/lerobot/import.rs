//! Imports episodes of a data set as bags.

mod actions;
mod bag;
mod episode;
mod placement;
mod timing;
mod videos;

use std::{ops::RangeInclusive, path::Path};

use crate::{ActionMapping, ImportReport};
use wm_bag::Shard;
use wm_motion::actions::{ActionSpace, ActionSurvey, Cause, Dimension, Kind};

use crate::lerobot::{
    LeRobotError,
    dataset::{Dataset, EpisodeEntry, Rows},
    info::ACTION,
};
use actions::Actions;
use episode::{Episode, ReadOptions};
use videos::Videos;

/// Number of episodes in the survey before the import, the same for all shards.
const SURVEY_EPISODES: usize = 256;

/// Options of an import.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Numbers of the episodes to import; `None` imports all.
    pub episodes: Option<RangeInclusive<i64>>,
    /// The shard to import, if several machines share an import.
    pub shard: Shard,
    /// JPEG quality of video frames, 1 to 100. Pictures in files are copied.
    pub jpeg_quality: u8,
    /// Stamp of the first frame of each episode, in ns since the epoch, as LeRobot has no time of day. Episodes from our own
    /// export keep theirs.
    pub start_ns: u64,
    /// Action space of the data set. `None`: Bridge V2's if the names are Bridge V2's, otherwise the bags have no action space.
    pub action_space: Option<ActionSpace>,
    /// Mapping of the action values to the action space.
    pub actions: ActionMapping,
    /// Whether frames are stamped by the rate, ignoring time stamps.
    pub is_nominal: bool,
}

impl Default for ImportOptions {
    fn default() -> Self {
        let bridge = crate::ImportOptions::default();
        Self {
            episodes: None,
            shard: Shard::WHOLE,
            jpeg_quality: bridge.jpeg_quality,
            start_ns: bridge.start_ns,
            action_space: None,
            actions: ActionMapping::default(),
            is_nominal: false,
        }
    }
}

/// Imports a LeRobot data set of version v2.1 or v3.0: each episode becomes a bag `OUT/episode_NNNNNN` with its number. A
/// shard may have no episodes.
///
/// Each bag has its origin, `DATASET#NUMBER`, as a note ([`wm_bag::ORIGIN`]).
///
/// Frame k of an episode belongs to row k. Its stamp is `start + k / fps`, to the nanosecond, if the `timestamp` of each row
/// agrees; otherwise `start` plus the time since the first row.
///
/// # Errors
/// `meta/` is missing or invalid, the actions do not fit the action space, no episode has a requested number or can be
/// imported (the error of the first), or a bag exists.
pub fn import(
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<ImportReport, LeRobotError> {
    let dataset = Dataset::open(src)?;
    let mut imported = ImportReport::default();
    let other = dataset.info.features.iter().filter(|(name, feature)| {
        !(feature.is_video() || feature.is_image() || episode::is_read(name))
    });
    let other: Vec<&str> = other.map(|(name, _)| name.as_str()).collect();
    if !other.is_empty() {
        let text = format!("features without a topic are ignored: {}", other.join(", "));
        imported.notes.of_data(text);
    }
    let actions = Actions::of(&dataset, options.action_space.as_ref(), options.actions)?;
    let is_wanted = |entry: &&EpisodeEntry| {
        let wanted = options.episodes.as_ref();
        wanted.is_none_or(|wanted| wanted.contains(&entry.index))
    };
    let wanted: Vec<&EpisodeEntry> = dataset.episodes.iter().filter(is_wanted).collect();
    if wanted.is_empty() {
        return Err(LeRobotError::Nothing(format!(
            "{} has {} episodes, but none of the requested numbers",
            src.display(),
            dataset.episodes.len()
        )));
    }
    let mut rows = Rows::default();
    if let Some(actions) = &actions {
        survey(&dataset, &wanted, actions, &mut rows, &mut imported, src)?;
    }
    let own = wanted.into_iter().enumerate();
    let own = own.filter(|(number, _)| options.shard.has(*number));
    let mut videos = Videos::of(&dataset);
    let reading = ReadOptions {
        jpeg_quality: options.jpeg_quality,
        is_nominal: options.is_nominal,
    };
    let mut first_error = None;
    let mut jitter_s = Vec::new();
    for (_, entry) in own {
        let read = episode::read(&dataset, entry, &mut rows, &mut videos, reading);
        let read = read.and_then(|episode| read_mapped(episode, actions.as_ref(), &dataset, entry));
        let episode = match read {
            Ok(episode) => episode,
            Err(error) => {
                imported.skip(&format!("episode {}: {error}", entry.index));
                first_error.get_or_insert(error);
                continue;
            }
        };
        let path = out.join(format!("episode_{:06}", entry.index));
        let start_ns = entry.start_ns.unwrap_or(options.start_ns);
        let origin = crate::origin::origin(src, None, Some(entry.index));
        let space = actions.as_ref().and_then(|actions| actions.space.as_ref());
        bag::write(&episode, space, &path, start_ns, &origin)?;
        tracing::info!(episode = entry.index, bag = %path.display(), frames = entry.length, "imported");
        for note in episode.notes {
            imported.notes.of_episode(note);
        }
        jitter_s.extend(episode.timing.jitter_s);
        imported.bags.push(path);
    }
    if let Some(text) = describe_jitter(&mut jitter_s, dataset.info.fps) {
        imported.notes.of_data(text);
    }
    match first_error {
        Some(error) if imported.bags.is_empty() => Err(match imported.skipped.len() {
            1 => error,
            count => LeRobotError::Nothing(format!(
                "none of {count} episodes can be imported; the first: {error}"
            )),
        }),
        _ => Ok(imported),
    }
}

/// Reads an episode and maps its actions.
fn read_mapped(
    mut episode: Episode,
    actions: Option<&Actions>,
    dataset: &Dataset,
    entry: &EpisodeEntry,
) -> Result<Episode, LeRobotError> {
    if let Some(actions) = actions {
        actions.map(&mut episode.actions);
        if let Some(space) = &actions.space {
            let mut survey = ActionSurvey::new(space.clone(), dataset.info.fps);
            survey.add(&episode.actions, &[] as &[Vec<f32>]);
            if let Some(reason) = actions.source().contradiction(&survey) {
                return Err(LeRobotError::corrupt(&entry.data, reason));
            }
        }
    }
    Ok(episode)
}

/// Measures the actions of the first episodes, of all shards.
///
/// # Errors
/// Most episodes contradict the kinds of the action space, or a gripper does.
fn survey(
    dataset: &Dataset,
    wanted: &[&EpisodeEntry],
    actions: &Actions,
    rows: &mut Rows,
    imported: &mut ImportReport,
    src: &Path,
) -> Result<(), LeRobotError> {
    let Some(space) = actions.space.clone().or_else(|| plain_space(dataset)) else {
        return Ok(());
    };
    let new = || ActionSurvey::new(space.clone(), dataset.info.fps);
    let mut whole = new();
    let mut contradicting = 0;
    for entry in wanted.iter().take(SURVEY_EPISODES) {
        // Unreadable episodes are named during the import.
        let Ok(mut values) = episode::read_actions(dataset, entry, rows) else {
            continue;
        };
        actions.map(&mut values);
        let mut alone = new();
        alone.add(&values, &[] as &[Vec<f32>]);
        contradicting += usize::from(!alone.contradictions().is_empty());
        whole.add(&values, &[] as &[Vec<f32>]);
    }
    if whole.episodes() == 0 {
        return Ok(());
    }
    imported.ranges = Some(whole.to_string());
    let source = actions.source();
    let found = whole.contradictions();
    if actions.space.is_none() {
        // Kinds by name are guesses.
        for found in &found {
            imported.notes.of_data(source.remedy(found));
        }
        let hints = whole.hints();
        hints
            .iter()
            .for_each(|hint| imported.notes.of_data(source.advice(hint)));
        return Ok(());
    }
    let is_gripper = |cause: &Cause| matches!(cause, Cause::Gripper { .. });
    let has_gripper = found.iter().any(|found| is_gripper(&found.cause));
    if (has_gripper || 2 * contradicting > whole.episodes())
        && let Some(reason) = source.contradiction(&whole)
    {
        return Err(crate::ImportError::Contradiction {
            path: src.to_owned(),
            episodes: whole.episodes(),
            contradicting,
            reason,
        }
        .into());
    }
    for hint in whole.hints() {
        imported.notes.of_data(source.advice(&hint));
    }
    Ok(())
}

/// A space with names only, to show the ranges: grippers by name, other values plain.
fn plain_space(dataset: &Dataset) -> Option<ActionSpace> {
    let names = dataset.info.features.get(ACTION)?.value_names();
    let dimensions = names.into_iter().map(|name| Dimension {
        kind: match name.to_ascii_lowercase().contains("grip") {
            true => Kind::GripperContinuous,
            false => Kind::JointPosition,
        },
        name,
        unit: "1".into(),
        offset: 0.0,
        scale: 1.0,
        clip: 1.0,
    });
    // More values than an action may have: no ranges.
    ActionSpace::new("unknown".into(), 1.0, dimensions.collect()).ok()
}

/// Describes the differences of frame periods from `1 / fps`; `None` without differences.
fn describe_jitter(jitter_s: &mut [f64], fps: f64) -> Option<String> {
    jitter_s.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| jitter_s.get(((jitter_s.len().checked_sub(1)?) as f64 * share) as usize);
    let ms = |seconds: &f64| (seconds * 10_000.0).round() / 10.0;
    Some(format!(
        "frames keep their recorded stamps: frame periods differ from {} ms by {} ms (median), {} ms (99 %) and {} ms \
         (most)",
        (10_000.0 / fps).round() / 10.0,
        ms(at(0.5)?),
        ms(at(0.99)?),
        ms(at(1.0)?)
    ))
}
