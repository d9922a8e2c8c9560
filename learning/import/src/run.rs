//! The import: a survey of the actions, then a bag per episode.

use std::path::Path;

use wm_motion::actions::{ActionSpace, ActionSurvey, Cause};

use crate::{
    ImportError, ImportOptions, ImportReport, episode::FoundEpisode, imported::is_made,
    remedy::ValueSource,
};

/// Number of episodes in the survey before the import, the same for all shards.
const SURVEY_EPISODES: usize = 256;

/// Writes each episode of the shard as a bag; other episodes are not read.
pub(crate) fn import<I: Iterator<Item = FoundEpisode>>(
    episodes: impl Fn() -> Result<I, ImportError>,
    src: &Path,
    out: &Path,
    options: &ImportOptions,
) -> Result<ImportReport, ImportError> {
    let mut imported = ImportReport::default();
    let most = options.episodes.unwrap_or(usize::MAX);
    if let Some((survey, source)) = survey(episodes()?, most, src, options)? {
        imported.ranges = Some(survey.to_string());
        for hint in survey.hints() {
            imported.notes.of_data(source.advice(&hint));
        }
    }
    let mut first_error = None;
    let mut number = 0;
    for found in episodes()? {
        if number == most {
            break;
        }
        let unread = match found {
            Ok(unread) => unread,
            // A faulty part of the data set takes no number.
            Err(error) => {
                imported.skip(&error);
                first_error.get_or_insert(error);
                continue;
            }
        };
        let own = number;
        number += 1;
        if !options.shard.has(own) {
            continue;
        }
        let bag = out.join(format!("episode_{own:06}"));
        let origin = unread.origin(src);
        if options.resume && is_made(&bag, &origin)? {
            imported.kept += 1;
            imported.bags.push(bag);
            continue;
        }
        let episode = match unread.read(&options.actions) {
            Ok(episode) => episode,
            Err(error) => {
                imported.skip(&error);
                first_error.get_or_insert(error);
                continue;
            }
        };
        episode.write(&bag, options.start_ns, &origin)?;
        tracing::info!(
            source = %episode.source.display(), bag = %bag.display(),
            frames = episode.recorded.actions.len(), cameras = episode.cameras.len(), "imported"
        );
        for note in episode.notes {
            imported.notes.of_episode(note);
        }
        imported.bags.push(bag);
    }
    match first_error {
        Some(error) if imported.bags.is_empty() => Err(match imported.skipped.len() {
            1 => error,
            count => ImportError::NoneImported {
                count,
                first: Box::new(error),
            },
        }),
        None if number == 0 => Err(ImportError::NoEpisodes(src.to_owned())),
        _ => Ok(imported),
    }
}

/// Measures the actions of the first episodes, of all shards; `None` without a readable episode.
///
/// # Errors
/// Most episodes contradict the kinds of Bridge V2's values, or a gripper does.
fn survey(
    episodes: impl Iterator<Item = FoundEpisode>,
    most: usize,
    src: &Path,
    options: &ImportOptions,
) -> Result<Option<(ActionSurvey, ValueSource)>, ImportError> {
    let mut whole: Option<(ActionSurvey, ValueSource)> = None;
    let mut contradicting = 0;
    let found = episodes.filter_map(Result::ok);
    for unread in found.take(most.min(SURVEY_EPISODES)) {
        // Unreadable episodes are named during the import.
        let Ok(recorded) = unread.recorded(&options.actions) else {
            continue;
        };
        let all = recorded.actions.iter().chain(&recorded.states).flatten();
        if !all.copied().all(f32::is_finite) {
            continue;
        }
        let alone = recorded.alone();
        contradicting += usize::from(!alone.contradictions().is_empty());
        let (whole, _) = whole.get_or_insert_with(|| {
            let survey = ActionSurvey::new(ActionSpace::bridge(), recorded.rate());
            (survey, recorded.source)
        });
        recorded.survey(whole);
    }
    let Some((whole, source)) = whole else {
        return Ok(None);
    };
    let found = whole.contradictions();
    let is_gripper = |cause: &Cause| matches!(cause, Cause::Gripper { .. });
    let has_gripper = found.iter().any(|found| is_gripper(&found.cause));
    if (has_gripper || 2 * contradicting > whole.episodes())
        && let Some(reason) = source.contradiction(&whole)
    {
        return Err(ImportError::Contradiction {
            path: src.to_owned(),
            episodes: whole.episodes(),
            contradicting,
            reason,
        });
    }
    Ok(Some((whole, source)))
}
