//! The process that trains a round.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{ExitStatus, Stdio},
    time::Duration,
};

use anyhow::{Context as _, Result};
use rustix::process::{Pid, Signal, kill_process};
use serde::Deserialize;
use tokio::process::{Child, Command};
use wm_msgs::{builtin_interfaces::Time, wm_msgs::LearnerRound};

/// The file with the result of a round, in its folder.
pub(super) const RESULT: &str = "result.json";
/// The file with the plan of a round, in its folder.
const PLAN: &str = "round.json";
/// Time for a process to save after a signal.
const GRACE: Duration = Duration::from_secs(8);

/// Settings of all rounds.
#[derive(Clone, Debug)]
pub(super) struct TrainingSettings {
    /// The program `wm`.
    pub program: PathBuf,
    /// Arguments after `train round`, but for the model.
    pub arguments: Vec<String>,
    /// Folder of the rounds.
    pub models: PathBuf,
    /// File that gets the output.
    pub log: PathBuf,
}

/// How a round ended: the part of `wm train round`'s result that the learner needs.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct RoundResult {
    /// Its number, from 1.
    pub round: u32,
    /// Duration of the data that it trained on \[s\].
    pub trained_on: f64,
    /// Duration of the data that it was tested on \[s\].
    pub tested_on: f64,
    /// The comparison with the model before.
    pub verdict: Verdict,
    /// Folder of the new model.
    pub model: PathBuf,
}

impl RoundResult {
    /// It as a message; `stamp` is the time of its end.
    pub(super) fn message(&self, stamp: Time) -> LearnerRound {
        LearnerRound {
            stamp,
            round: self.round,
            trained_on: self.trained_on as f32,
            tested_on: self.tested_on as f32,
            ratio: self.verdict.ratio as f32,
            ratio_before: self.verdict.ratio_before as f32,
            p_value: self.verdict.p_value as f32,
            accepted: self.verdict.is_better,
            model: self.model.display().to_string(),
        }
    }
}

/// See [`RoundResult::verdict`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(super) struct Verdict {
    /// The new model's squared latent error over that of the last frame, repeated.
    pub ratio: f64,
    /// The same of the model before.
    pub ratio_before: f64,
    /// p of the paired test.
    pub p_value: f64,
    /// Whether the new model is better.
    pub is_better: bool,
}

/// The steps of a round: the part of its plan that the learner needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
pub(super) struct RoundSteps {
    /// Of the transition model.
    pub transition_steps: u64,
    /// Of the inverse dynamics model; 0: none.
    pub idm_steps: u64,
}

/// The steps of the round in a folder; `None` before its plan is written.
pub(super) fn steps_of(folder: &Path) -> Option<RoundSteps> {
    let text = fs::read_to_string(folder.join(PLAN)).ok()?;
    serde_json::from_str(&text).ok()
}

/// The progress of a round.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Progress {
    /// The trained part.
    pub part: String,
    /// Its optimiser step.
    pub step: u64,
}

/// A running round.
pub(super) struct Training {
    child: Child,
    is_paused: bool,
}

impl Training {
    /// Starts or resumes a round from `model`.
    ///
    /// # Errors
    /// The program cannot be started.
    pub(super) fn begin(settings: &TrainingSettings, model: &str) -> Result<Self> {
        let log = fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&settings.log);
        let log = log.with_context(|| settings.log.display().to_string())?;
        let child = Command::new(&settings.program)
            .args(["train", "round", "--from", model])
            .args(&settings.arguments)
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            .kill_on_drop(true)
            .spawn()
            .with_context(|| settings.program.display().to_string())?;
        Ok(Self {
            child,
            is_paused: false,
        })
    }

    /// Waits for the end of the process. Cancel safe.
    ///
    /// # Errors
    /// As [`Child::wait`].
    pub(super) async fn ended(&mut self) -> std::io::Result<ExitStatus> {
        self.child.wait().await
    }

    /// Its process id, while it runs.
    pub(super) fn id(&self) -> Option<u32> {
        self.child.id()
    }

    /// Whether it is paused.
    pub(super) fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Stops its process for a while, or lets it go on.
    pub(super) fn pause(&mut self, is_paused: bool) {
        if is_paused != self.is_paused {
            self.signal(if is_paused {
                Signal::STOP
            } else {
                Signal::CONT
            });
            self.is_paused = is_paused;
        }
    }

    /// Ends the process; it saves before, so that the round resumes later.
    pub(super) async fn end(mut self) {
        self.pause(false);
        self.signal(Signal::TERM);
        if tokio::time::timeout(GRACE, self.child.wait())
            .await
            .is_err()
        {
            self.child.kill().await.ok();
        }
    }

    fn signal(&self, signal: Signal) {
        let pid = self
            .child
            .id()
            .and_then(|id| Pid::from_raw(id.cast_signed()));
        if let Some(pid) = pid {
            // It may just have ended.
            kill_process(pid, signal).ok();
        }
    }
}

/// The rounds in the folder, in their order: number and folder.
pub(super) fn rounds(models: &Path) -> Result<Vec<(u32, PathBuf)>> {
    let mut rounds = Vec::new();
    for entry in fs::read_dir(models).with_context(|| models.display().to_string())? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str());
        let number = name.and_then(|name| name.strip_prefix("round-")?.parse().ok());
        rounds.extend(number.map(|number: u32| (number, path)));
    }
    rounds.sort();
    Ok(rounds)
}

/// The result of the round in a folder; `None` while it is unfinished.
///
/// # Errors
/// The file cannot be read, or is not a result.
pub(super) fn result_of(folder: &Path) -> Result<Option<RoundResult>> {
    let path = folder.join(RESULT);
    if !path.is_file() {
        return Ok(None);
    }
    let text = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let result = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    Ok(Some(result))
}

/// Deletes the weights of accepted models, except the newest `most`. What the rounds measured stays.
///
/// # Errors
/// A folder cannot be read, or a file not be deleted.
pub(super) fn delete_old_models(models: &Path, most: usize) -> Result<()> {
    let mut better = Vec::new();
    for (_, folder) in rounds(models)? {
        let result = result_of(&folder)?;
        if result.is_some_and(|result| result.verdict.is_better) {
            better.push(folder);
        }
    }
    let old = better.len().saturating_sub(most);
    for folder in better.into_iter().take(old) {
        for entry in fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            if path.extension().is_some_and(|it| it == "safetensors") {
                fs::remove_file(&path).with_context(|| path.display().to_string())?;
                tracing::info!(
                    "deleted {}: the newest {most} models are kept",
                    path.display()
                );
            }
        }
    }
    Ok(())
}

/// The progress of the round in a folder at its last checkpoint, by the journal that was written last.
pub(super) fn progress_of(folder: &Path) -> Option<Progress> {
    let journals = fs::read_dir(folder).ok()?.flatten();
    let journals = journals.filter_map(|entry| {
        let name = entry.file_name().into_string().ok()?;
        let part = name.strip_suffix(".journal.jsonl")?.to_owned();
        Some((entry.metadata().ok()?.modified().ok()?, part, entry.path()))
    });
    let (_, part, path) = journals.max()?;
    let text = fs::read_to_string(path).ok()?;
    // A step is numbered from 0; a validation has the number of steps before it.
    let step = |line: &str| {
        let line: serde_json::Value = serde_json::from_str(line).ok()?;
        let step = line.get("step")?.as_u64()?;
        Some(step + u64::from(line.get("loss").is_some()))
    };
    let step = text.lines().rev().find_map(step)?;
    Some(Progress { part, step })
}

/// Whether the round in a folder has trained the part `last` for all its `steps`, and so tests the new model.
pub(super) fn is_tested(folder: &Path, progress: &Progress, last: &str, steps: u64) -> bool {
    progress.part == last
        && progress.step >= steps
        && folder.join(format!("{last}.safetensors")).is_file()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_that_of_the_newest_journal() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(progress_of(folder.path()), None);
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
        write(
            "autoencoder.journal.jsonl",
            "{\"step\":0,\"loss\":1}\n{\"step\":41,\"loss\":1}\n",
        );
        let progress = progress_of(folder.path()).unwrap();
        assert_eq!((progress.part.as_str(), progress.step), ("autoencoder", 42));
        // A line that is being written does not count.
        write(
            "transition.journal.jsonl",
            "{\"step\":7,\"loss\":1}\n{\"ste",
        );
        let later = std::time::SystemTime::now() + Duration::from_secs(5);
        let journal = fs::File::options()
            .write(true)
            .open(folder.path().join("transition.journal.jsonl"));
        journal.unwrap().set_modified(later).unwrap();
        let progress = progress_of(folder.path()).unwrap();
        assert_eq!((progress.part.as_str(), progress.step), ("transition", 8));
        fs::remove_file(folder.path().join("autoencoder.journal.jsonl")).unwrap();
        write(
            "transition.journal.jsonl",
            "{\"step\":9,\"loss\":1}\n{\"step\":10,\"validation\":{}}\n",
        );
        assert_eq!(progress_of(folder.path()).unwrap().step, 10);
    }

    #[test]
    fn new_model_is_tested_once_its_last_part_is_trained() {
        let folder = tempfile::tempdir().unwrap();
        let write = |part: &str| {
            let path = folder.path().join(format!("{part}.safetensors"));
            fs::write(path, "").unwrap();
        };
        let tests = |part: &str, step, last: &str| {
            let part = part.to_owned();
            is_tested(folder.path(), &Progress { part, step }, last, 200)
        };
        assert!(!tests("transition", 200, "transition"), "it is being saved");
        write("transition");
        assert!(!tests("transition", 199, "transition"));
        assert!(tests("transition", 200, "transition"), "without idm_steps");
        assert!(!tests("transition", 200, "idm"));
        write("idm");
        assert!(tests("idm", 200, "idm"));
    }

    #[test]
    fn weights_of_old_models_are_deleted() {
        let models = tempfile::tempdir().unwrap();
        let weights = |round: u32| {
            let folder = models.path().join(format!("round-{round:04}"));
            folder.join("transition.safetensors")
        };
        for round in 1..=6 {
            let folder = models.path().join(format!("round-{round:04}"));
            fs::create_dir(&folder).unwrap();
            fs::write(weights(round), "").unwrap();
            // The fourth was no better.
            let text = format!(
                r#"{{"round":{round},"trained_on":120.0,"tested_on":30.0,"model":"m","verdict":{{"ratio":0.7,
                    "ratio_before":0.9,"p_value":0.01,"windows":99,"is_better":{}}}}}"#,
                round != 4
            );
            fs::write(folder.join(RESULT), text).unwrap();
        }
        // One that is being trained.
        fs::create_dir(models.path().join("round-0007")).unwrap();
        fs::write(weights(7), "").unwrap();
        for _ in 0..2 {
            delete_old_models(models.path(), 2).unwrap();
            let kept: Vec<u32> = (1..=7).filter(|round| weights(*round).is_file()).collect();
            assert_eq!(kept, [4, 5, 6, 7]);
        }
        assert!(
            result_of(&models.path().join("round-0002"))
                .unwrap()
                .is_some()
        );
    }

    #[test]
    fn result_of_wm_train_round_is_read() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(result_of(folder.path()).unwrap(), None);
        let text = r#"{"round":3,"trained_on":120.0,"tested_on":30.0,"model":"m/round-0003","verdict":
            {"ratio":0.7,"ratio_before":0.9,"p_value":0.01,"windows":99,"is_better":true}}"#;
        fs::write(folder.path().join("result.json"), text).unwrap();
        let result = result_of(folder.path()).unwrap().unwrap();
        assert!(result.round == 3 && result.verdict.is_better);
        fs::write(folder.path().join("result.json"), "{}").unwrap();
        assert!(result_of(folder.path()).is_err());
    }
}
