use anyhow::ensure;
use serde_json::json;
use wm_evaluation::Figure;

use super::*;

/// Two numbers that descend along their squares; some steps are not finite.
struct Descent {
    at: Vec<f32>,
    broken: std::ops::Range<u64>,
    /// Sets `Stop` at this step.
    stop: Option<(u64, Stop)>,
    written: Vec<f32>,
}

fn descent() -> Descent {
    Descent {
        at: vec![3.0, -2.0],
        broken: 0..0,
        stop: None,
        written: Vec::new(),
    }
}

/// Checks that a training by `train(folder, steps)` writes the same files after a pause at step `pause` as in one run of
/// `steps`, in folders of `dir`. Its learning rate must not depend on the number of steps.
pub(crate) fn expect_same_bytes_after_pause(
    dir: &Path,
    files: &[&str],
    [pause, steps]: [u64; 2],
    mut train: impl FnMut(&Path, u64),
) {
    let (whole, parts) = (dir.join("whole"), dir.join("parts"));
    train(&whole, steps);
    train(&parts, pause);
    train(&parts, steps);
    for file in files {
        let read = |out: &Path| std::fs::read(out.join(file)).unwrap();
        assert!(read(&whole) == read(&parts), "{}: {file}", dir.display());
    }
}

impl Learner for Descent {
    fn parameters(&self) -> Result<Vec<Parameter>> {
        Ok(vec![Parameter {
            name: "at".into(),
            shape: vec![2],
            values: self.at.clone(),
            group: 0,
        }])
    }

    fn step(&mut self, step: u64) -> Result<StepLoss> {
        if let Some((at, stop)) = &self.stop
            && *at == step
        {
            stop.ask();
        }
        let is_broken = self.broken.contains(&step);
        let loss: f32 = self.at.iter().map(|x| x * x).sum();
        Ok(StepLoss {
            loss: if is_broken { f32::NAN } else { loss },
            parts: Vec::new(),
            gradient: vec![
                self.at
                    .iter()
                    .map(|x| 2.0 * x + step as f32 * 1e-3)
                    .collect(),
            ],
        })
    }

    fn assign(&mut self, weights: &mut dyn Iterator<Item = ParameterValues<'_>>) -> Result<()> {
        let weights = weights.next().context("weights")?;
        ensure!(weights.name == "at");
        self.at = weights.values.to_vec();
        Ok(())
    }
}

impl Task for Descent {
    fn name(&self) -> &'static str {
        "descent"
    }

    fn files(&self) -> &'static [&'static str] {
        &["weights"]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        self.written = averaged.next().context("weights")?.values.to_vec();
        std::fs::write(folder.join("weights"), format!("{:?}", self.written))?;
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        Ok(vec![Figure::new("thorough", f64::from(u8::from(thorough)))])
    }
}

fn settings(out: &Path, steps: u64) -> RunSettings {
    RunSettings {
        out: out.to_owned(),
        steps,
        schedule: Schedule::new(0.05, 2, 40, 0.1),
        optimiser: AdamWSettings::default(),
        checkpoint_every: Duration::from_secs(3600),
        validate_every: 15,
        identity: json!({"seed": 1}),
    }
}

#[test]
fn stopped_and_resumed_run_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let (whole, parts) = (dir.path().join("whole"), dir.path().join("parts"));
    let ended = train(&mut descent(), &settings(&whole, 40), &Stop::default()).unwrap();
    assert_eq!(ended, RunEnd::Finished);

    let stop = Stop::default();
    let mut first = Descent {
        stop: Some((20, stop.clone())),
        ..descent()
    };
    let ended = train(&mut first, &settings(&parts, 40), &stop).unwrap();
    assert_eq!(ended, RunEnd::Stopped);
    // The state so far is written, and marked.
    let mark = Unfinished {
        part: "descent".to_owned(),
        step: 21,
        steps: 40,
    };
    assert_eq!(Unfinished::all(&parts).unwrap(), [mark]);
    assert!(!first.written.is_empty() && parts.join("weights").is_file());
    let mut second = descent();
    train(&mut second, &settings(&parts, 40), &Stop::default()).unwrap();
    for folder in [&whole, &parts] {
        assert_eq!(Unfinished::all(folder).unwrap(), []);
    }
    for file in [
        "weights",
        "descent.journal.jsonl",
        "descent.checkpoint.safetensors",
    ] {
        let read = |folder: &Path| std::fs::read(folder.join(file)).unwrap();
        assert_eq!(read(&whole), read(&parts), "{file}");
    }

    // More steps than before continue; fewer are rejected.
    train(&mut descent(), &settings(&parts, 50), &Stop::default()).unwrap();
    let error = train(&mut descent(), &settings(&parts, 10), &Stop::default()).unwrap_err();
    assert!(error.to_string().contains("50 steps are taken"), "{error}");
}

#[test]
fn infinite_step_is_skipped_and_ten_in_a_row_end_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let mut task = Descent {
        broken: 5..8,
        ..descent()
    };
    let out = dir.path().join("few");
    train(&mut task, &settings(&out, 40), &Stop::default()).unwrap();
    assert!(task.written.iter().all(|x| x.is_finite()));
    let journal = std::fs::read_to_string(out.join("descent.journal.jsonl")).unwrap();
    assert!(!journal.contains("\"step\":6,\"loss\""), "{journal}");

    let out = dir.path().join("many");
    let mut task = Descent {
        broken: 17..100,
        ..descent()
    };
    let error = train(&mut task, &settings(&out, 40), &Stop::default()).unwrap_err();
    let error = format!("{error:#}");
    assert!(
        error.contains("10 steps in a row") && error.contains("last good checkpoint"),
        "{error}"
    );
    // The checkpoint of step 15, from which a later run continues.
    train(&mut descent(), &settings(&out, 40), &Stop::default()).unwrap();
}

#[test]
fn checkpoint_of_other_settings_is_rejected_by_difference() {
    let dir = tempfile::tempdir().unwrap();
    train(&mut descent(), &settings(dir.path(), 10), &Stop::default()).unwrap();
    let other = RunSettings {
        identity: json!({"seed": 2}),
        ..settings(dir.path(), 10)
    };
    let error = train(&mut descent(), &other, &Stop::default()).unwrap_err();
    let error = format!("{error:#}");
    assert!(
        error.contains("seed: 1 in the checkpoint, 2 now"),
        "{error}"
    );
}

/// A fine-tuning into its own folder, or a mistyped folder, loses nothing.
#[test]
fn foreign_files_are_not_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let theirs = dir.path().join("weights");
    std::fs::write(&theirs, "theirs").unwrap();
    let error = train(&mut descent(), &settings(dir.path(), 10), &Stop::default()).unwrap_err();
    assert!(error.to_string().contains("use another --out"), "{error}");
    assert_eq!(std::fs::read_to_string(&theirs).unwrap(), "theirs");
}
