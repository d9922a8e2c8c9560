//! The learner's output folder.

use std::{
    fs::{self, File, TryLockError},
    path::Path,
    time::UNIX_EPOCH,
};

use anyhow::{Context as _, Result, bail};
use wm_msgs::{builtin_interfaces::Time, wm_msgs::LearnerRound};

use super::{
    RecordingSettings, Resources, Schedule, TrainingSettings,
    parameters::Parameters,
    recording::recover_all,
    resources::GIB,
    schedule::ScheduleSettings,
    training::{RESULT, result_of, rounds},
};
use crate::space::action_space;

/// Most rounds in a status.
pub(super) const MOST_ROUNDS: usize = 100;
/// File with the model in use.
pub(super) const IN_USE: &str = "in_use.txt";

/// File that the learner of a folder locks.
const LOCK: &str = "learner.lock";

/// The output folder, and what an earlier run left there.
pub(super) struct Workplace {
    pub recording: RecordingSettings,
    pub training: TrainingSettings,
    pub resources: Resources,
    pub schedule: Schedule,
    /// Duration of the recordings on the disk \[s\].
    pub recorded_s: f64,
    pub rounds: Vec<LearnerRound>,
    /// The model in use.
    pub model: String,
    /// Locked as long as the file is open.
    _lock: File,
}

impl Workplace {
    /// Opens the output folder, and continues with what is there.
    pub(super) fn open(parameters: &Parameters) -> Result<Self> {
        // Nodes with another working directory find the models too.
        let output = std::path::absolute(&parameters.output)?;
        let (recordings, models) = (output.join("recordings"), output.join("models"));
        for folder in [&recordings, &models] {
            fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        }
        let lock = lock(&output)?;
        let space = action_space(&parameters.action_space)?;
        let recorded_s = recover_all(&recordings)?;
        let mut finished = Vec::new();
        for (_, folder) in rounds(&models)? {
            let Some(result) = result_of(&folder)? else {
                continue;
            };
            let ended = fs::metadata(folder.join(RESULT))?.modified()?;
            let since = ended
                .duration_since(UNIX_EPOCH)
                .context("a clock before 1970")?;
            let stamp = Time::from_nanos(i64::try_from(since.as_nanos())?);
            finished.push(result.message(stamp));
        }
        let surplus = finished.len().saturating_sub(MOST_ROUNDS);
        finished.drain(..surplus);
        let in_use = output.join(IN_USE);
        let model = match in_use.is_file() {
            true => fs::read_to_string(&in_use).with_context(|| in_use.display().to_string())?,
            false => parameters.model.clone(),
        };
        let schedule = ScheduleSettings {
            first_s: parameters.first_seconds,
            more_s: parameters.more_seconds,
        };
        Ok(Self {
            schedule: Schedule::new(schedule, recorded_s, !finished.is_empty()),
            recording: RecordingSettings {
                folder: recordings.clone(),
                bag_ns: (parameters.bag_seconds * 1e9) as u64,
                picture_side: parameters.picture_side,
                quality: parameters.jpeg_quality,
                action_space: serde_json::to_string(&space)?,
            },
            training: TrainingSettings {
                program: std::env::current_exe()?,
                arguments: arguments(parameters, &recordings, &models),
                models,
                log: output.join("training.log"),
            },
            resources: Resources {
                most_c: parameters.max_temperature,
                most_memory: (parameters.max_memory * GIB) as u64,
                least_free: (parameters.min_free * GIB) as u64,
            },
            recorded_s,
            rounds: finished,
            model,
            _lock: lock,
        })
    }
}

/// Reserves a learner's folder until the file is closed, also by a kill.
fn lock(output: &Path) -> Result<File> {
    let path = output.join(LOCK);
    let file = File::create(&path).with_context(|| path.display().to_string())?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => bail!(
            "another learner works in {}: end it, or set the parameter output to another folder",
            output.display()
        ),
        Err(TryLockError::Error(error)) => Err(error).with_context(|| path.display().to_string()),
    }
}

/// The arguments of `wm train round`.
fn arguments(parameters: &Parameters, recordings: &Path, models: &Path) -> Vec<String> {
    let path = |path: &Path| path.display().to_string();
    let mut arguments = vec![
        ("--recordings", path(recordings)),
        ("--models", path(models)),
        (
            "--autoencoder-steps",
            parameters.autoencoder_steps.to_string(),
        ),
        (
            "--transition-steps",
            parameters.transition_steps.to_string(),
        ),
        ("--idm-steps", parameters.idm_steps.to_string()),
        ("--seconds", parameters.round_seconds.to_string()),
        ("--least-psnr", parameters.least_psnr.to_string()),
        ("--most-bags", parameters.most_bags.to_string()),
        ("--test-bags", parameters.test_bags.to_string()),
        ("--nice", parameters.nice.to_string()),
    ];
    if !parameters.processors.is_empty() {
        let processors: Vec<String> = parameters.processors.iter().map(i64::to_string).collect();
        arguments.push(("--processors", processors.join(",")));
    }
    if parameters.threads > 0 {
        arguments.push(("--threads", parameters.threads.to_string()));
    }
    let sets = parameters.recipe.iter().map(|set| ("--set", set.clone()));
    arguments.extend(sets);
    let words = arguments
        .into_iter()
        .flat_map(|(name, value)| [name.to_owned(), value]);
    words.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_learner_works_in_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let first = lock(folder.path()).unwrap();
        let text = lock(folder.path()).unwrap_err().to_string();
        assert!(text.contains("another learner works in"), "{text}");
        assert!(text.contains(&folder.path().display().to_string()));
        drop(first);
        lock(folder.path()).unwrap();
    }
}
