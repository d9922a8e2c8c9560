//! Imports episodes of a data set as bags.

mod actions;
mod bag;
mod derived;
mod episode;
mod placement;
mod timing;
mod value_name;
mod videos;

use std::{
    fs,
    io::{ErrorKind, Write as _},
    ops::RangeInclusive,
    path::Path,
};

use crate::{ActionMapping, ImportReport, imported::is_made};
use wm_bag::Shard;
use wm_motion::actions::{ActionSpace, ActionSurvey, Cause};

use crate::lerobot::{
    LeRobotError,
    dataset::{Dataset, EpisodeEntry, Rows},
};
use actions::Actions;
use episode::{Episode, ReadOptions};
use videos::Videos;

/// Number of episodes in the survey before the import, the same for all shards.
const SURVEY_EPISODES: usize = 256;

/// Name of the file beside the bags with a derived action space.
pub const ACTION_SPACE_FILE: &str = "action_space.json";

/// Options of an import.
#[derive(Clone, Debug)]
pub struct ImportOptions {
    /// Numbers of the episodes to import; `None` imports all.
    pub episodes: Option<RangeInclusive<i64>>,
    /// The shard to import, if several machines share an import.
    pub shard: Shard,
    /// Whether whole bags of the same episodes, of an earlier run, are kept instead of an error.
    pub resume: bool,
    /// JPEG quality of video frames, 1 to 100. Pictures in files are copied.
    pub jpeg_quality: u8,
    /// Stamp of the first frame of each episode, in ns since the epoch, as LeRobot has no time of day. Episodes from our own
    /// export keep theirs.
    pub start_ns: u64,
    /// Action space of the data set. `None`: Bridge V2's if the names are Bridge V2's, otherwise one that is derived from the
    /// names and the recorded values, and written to [`ACTION_SPACE_FILE`].
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
            resume: false,
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
/// An action space that neither the options nor the names give is derived from the names and values of the first 256
/// episodes of the data set: the same for all shards and all `episodes`. The bags keep it, and it is written to
/// `OUT/action_space.json`, unless that file exists.
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
    let given = options.action_space.as_ref();
    let actions = Actions::of(&dataset, given, options.actions, &mut rows)?;
    if let Some(actions) = &actions {
        if let Some(error) = &actions.unfit {
            tracing::warn!(%error, "importing bags without an action space");
            imported.notes.of_data(format!(
                "{error}; the bags have no action space, so no model of actions can be trained on them"
            ));
        }
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
        let path = out.join(format!("episode_{:06}", entry.index));
        let origin = crate::origin::origin(src, None, Some(entry.index));
        if options.resume && is_made(&path, &origin)? {
            imported.kept += 1;
            imported.bags.push(path);
            continue;
        }
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
        let start_ns = entry.start_ns.unwrap_or(options.start_ns);
        let space = actions.as_ref().and_then(|actions| actions.space.as_ref());
        bag::write(&episode, space, &path, start_ns, &origin)?;
        tracing::info!(episode = entry.index, bag = %path.display(), frames = entry.length, "imported");
        if let Some(derived) = actions
            .as_ref()
            .and_then(|actions| actions.derived.as_ref())
            && imported.bags.len() == imported.kept
        {
            write_derived(&derived.space, out, &mut imported)?;
        }
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
        // A derived space is no reason to skip an episode.
        if let Some(space) = actions.space.as_ref().filter(|_| actions.derived.is_none()) {
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
    let Some(space) = &actions.space else {
        return Ok(());
    };
    let new = || ActionSurvey::new(space.clone(), dataset.info.fps);
    let mut whole = new();
    let mut contradicting = 0;
    for entry in wanted.iter().take(SURVEY_EPISODES) {
        // Unreadable episodes are named during the import.
        let Ok((mut values, _)) = episode::read_values(dataset, entry, rows) else {
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
    if let Some(derived) = &actions.derived {
        imported.ranges = Some(derived.to_string());
        for found in &found {
            imported.notes.of_data(source.remedy(found));
        }
    }
    let is_gripper = |cause: &Cause| matches!(cause, Cause::Gripper { .. });
    let has_gripper = found.iter().any(|found| is_gripper(&found.cause));
    if actions.derived.is_none()
        && (has_gripper || 2 * contradicting > whole.episodes())
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

/// Writes a derived space to [`ACTION_SPACE_FILE`], unless that file exists.
fn write_derived(
    space: &ActionSpace,
    out: &Path,
    imported: &mut ImportReport,
) -> Result<(), LeRobotError> {
    let path = out.join(ACTION_SPACE_FILE);
    let io = |error| LeRobotError::io(&path, error);
    let mut text = serde_json::to_string_pretty(space).map_err(|error| io(error.into()))?;
    text.push('\n');
    let how = "check kinds and units; to correct them, edit a copy of";
    let again = "and import again into another folder with --action-space COPY";
    match fs::File::create_new(&path) {
        Ok(mut file) => {
            file.write_all(text.as_bytes()).map_err(io)?;
            let text = format!("the derived action space: {how} {} {again}", path.display());
            imported.notes.of_data(text);
        }
        // Another shard, or an earlier import.
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            let is_same = fs::read(&path).is_ok_and(|found| found == text.as_bytes());
            imported.notes.of_data(match is_same {
                true => format!("the derived action space: {how} {} {again}", path.display()),
                false => format!(
                    "{} exists with other contents and stays as it is; the bags have the derived action space. \
                     If the file is yours, import again into another folder with --action-space {}",
                    path.display(),
                    path.display()
                ),
            });
        }
        Err(error) => return Err(io(error)),
    }
    Ok(())
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
