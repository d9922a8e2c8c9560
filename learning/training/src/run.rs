//! Runs a training: steps, checkpoints, validation, progress, and a clean end.
//!
//! A [`Task`] supplies network and data. The run resumes from a checkpoint of the same training, saves on SIGINT and
//! SIGTERM, and skips steps with a loss that is not finite. It writes a journal (a line per step and validation) with
//! pictures, and event files for TensorBoard. File names start with the task's name, so that trainings may share a
//! folder.
//!
//! The model is written at each validation, on stop and at the end; until the end, it has the mark [`Unfinished`].

mod events;
mod journal;
mod progress;
mod stop;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use image::RgbImage;
use serde_json::Value;

use crate::optimiser::{
    AdamW, AdamWSettings, Group, OptimiserError, Parameter, ParameterValues, Schedule,
};
use events::Events;
pub use journal::Journal;
use progress::Progress;
pub use stop::Stop;
use wm_evaluation::Figure;
use wm_zoo::Unfinished;

/// Consecutive steps without a finite loss that end a run.
const MOST_SKIPPED: u32 = 10;

/// The loss of a step and its gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct StepLoss {
    /// The minimised value.
    pub loss: f32,
    /// Notable parts of the loss, by name.
    pub parts: Vec<(&'static str, f64)>,
    /// Gradient by parameter, in the order of [`Learner::parameters`].
    pub gradient: Vec<Vec<f32>>,
}

/// The parameters of a task, with loss and gradient of each step.
pub trait Learner {
    /// The parameters at step 0.
    ///
    /// # Errors
    /// If they cannot be made.
    fn parameters(&self) -> Result<Vec<Parameter>>;

    /// Groups of the parameters.
    fn groups(&self) -> Vec<Group> {
        vec![Group::default()]
    }

    /// Prepares for the first step of a run, whose parameters are assigned.
    fn begin(&mut self, stop: &Stop) {
        let _ = stop;
    }

    /// Loss and gradient of the samples of step `step`, which depend only on the step and the seed.
    ///
    /// # Errors
    /// If data or network fail; a loss that is not finite is not an error.
    fn step(&mut self, step: u64) -> Result<StepLoss>;

    /// Notices for the user since the last call.
    fn take_notices(&mut self) -> Vec<String> {
        Vec::new()
    }

    /// Assigns the parameters after a step.
    ///
    /// # Errors
    /// If they do not fit.
    fn assign(&mut self, weights: &mut dyn Iterator<Item = ParameterValues<'_>>) -> Result<()>;

    /// Assigns the averaged parameters after a step, for trainings with targets from them.
    ///
    /// # Errors
    /// If they do not fit.
    fn assign_averaged(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
    ) -> Result<()> {
        let _ = averaged;
        Ok(())
    }
}

/// A training task.
pub trait Task: Learner {
    /// Name of the task, and prefix of its files.
    fn name(&self) -> &'static str;

    /// Files that [`Self::write`] writes into its folder.
    fn files(&self) -> &'static [&'static str];

    /// The run continues from a checkpoint, whose parameters are assigned.
    fn resumed(&mut self) {}

    /// Writes the model's files with the averaged parameters into `folder`.
    ///
    /// # Errors
    /// If a file cannot be written.
    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()>;

    /// Figures of the model written last, on validation data if any. `thorough` at the last step: on all of them.
    ///
    /// # Errors
    /// If data or network fail.
    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let _ = thorough;
        Ok(Vec::new())
    }

    /// A picture with samples of the model written last.
    ///
    /// # Errors
    /// If data or network fail.
    fn samples(&mut self) -> Result<Option<RgbImage>> {
        Ok(None)
    }
}

/// Settings of a run.
#[derive(Clone, Debug)]
pub struct RunSettings {
    /// Folder of all files.
    pub out: PathBuf,
    /// Number of steps.
    pub steps: u64,
    /// Learning rates.
    pub schedule: Schedule,
    /// The optimiser.
    pub optimiser: AdamWSettings,
    /// Wall-clock time between checkpoints.
    pub checkpoint_every: Duration,
    /// Steps between validations.
    pub validate_every: u64,
    /// Everything that affects the result except the number of steps: recipe and data. Checkpoints of another identity are
    /// rejected.
    pub identity: Value,
}

/// End of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// After the last step.
    Finished,
    /// Earlier, on request; it resumes from its checkpoint.
    Stopped,
}

/// Trains `task` to the last step, or until `stop` is set.
///
/// # Errors
/// If the folder has a checkpoint of another training, data or network fail, a file cannot be written, or ten
/// consecutive losses are not finite (the last good checkpoint stays).
pub fn train(task: &mut dyn Task, settings: &RunSettings, stop: &Stop) -> Result<RunEnd> {
    let out = &settings.out;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let mut run = Run::new(task, settings)?;
    run.resume()?;
    run.announce();
    if run.optimiser.steps_taken() < settings.steps {
        run.task.begin(stop);
    }
    let mut progress = Progress::new(settings.steps, run.optimiser.steps_taken());
    let mut saved = Instant::now();
    while run.optimiser.steps_taken() < settings.steps {
        if stop.is_asked() {
            let is_saved = run.save()?;
            drop(progress);
            let (done, all) = (run.optimiser.steps_taken(), settings.steps);
            let saved = match is_saved {
                true => "and saved",
                false => "among steps that are not finite, with the checkpoint from before them,",
            };
            println!("stopped {saved} after step {done} of {all}; the same command resumes");
            // Without their checkpoint, the weights would block the next run; at step 0 they are noise.
            if is_saved
                && done > 0
                && let Err(error) = run.write()
            {
                tracing::warn!("what is saved is not written as a model: {error:#}");
            }
            return Ok(RunEnd::Stopped);
        }
        let line = run.step()?;
        for notice in run.task.take_notices() {
            progress.say(&notice);
        }
        progress.step(&line);
        let done = run.optimiser.steps_taken();
        let is_last = done == settings.steps;
        if is_last || done.is_multiple_of(settings.validate_every.max(1)) {
            progress.validating(&line);
            run.save()?;
            let line = run.validate(is_last)?;
            progress.say(&line);
            saved = Instant::now();
        } else if saved.elapsed() >= settings.checkpoint_every {
            run.save()?;
            saved = Instant::now();
        }
    }
    drop(progress);
    if !run.has_written {
        // An earlier run took the last step, but ended before writing.
        run.write()?;
    }
    Ok(RunEnd::Finished)
}

/// Checkpoint of the training `name` in its folder.
pub(crate) fn checkpoint(out: &Path, name: &str) -> PathBuf {
    out.join(format!("{name}.checkpoint.safetensors"))
}

/// Ensures that a new training replaces no foreign files, such as the model that it starts from.
///
/// # Errors
/// Names the first of `files` that exists in `out`.
pub(crate) fn expect_nothing_to_overwrite(out: &Path, files: &[&str]) -> Result<()> {
    let mut paths = files.iter().map(|file| out.join(file));
    if let Some(path) = paths.find(|path| path.exists()) {
        bail!(
            "{} is there, but no checkpoint of a training that made it; use another --out, or move it",
            path.display()
        );
    }
    Ok(())
}

struct Run<'a> {
    task: &'a mut dyn Task,
    settings: &'a RunSettings,
    optimiser: AdamW,
    journal: Journal,
    events: Events,
    /// Consecutive steps that were not finite.
    in_a_row: u32,
    has_written: bool,
}

impl<'a> Run<'a> {
    fn new(task: &'a mut dyn Task, settings: &'a RunSettings) -> Result<Self> {
        let parameters = task.parameters()?;
        let optimiser = AdamW::in_groups(parameters, task.groups(), settings.optimiser.clone());
        Ok(Self {
            events: Events::create(&settings.out, task.name())?,
            task,
            settings,
            optimiser,
            journal: Journal::default(),
            in_a_row: 0,
            has_written: false,
        })
    }

    fn checkpoint(&self) -> PathBuf {
        checkpoint(&self.settings.out, self.task.name())
    }

    fn resume(&mut self) -> Result<()> {
        let checkpoint = self.checkpoint();
        if checkpoint.is_file() {
            self.optimiser
                .resume(&checkpoint, &self.settings.identity)
                .context("use another --out to begin anew")?;
            let done = self.optimiser.steps_taken();
            if done > self.settings.steps {
                bail!(
                    "{}: {done} steps are taken, more than the {} asked for; use another --out to begin anew",
                    checkpoint.display(),
                    self.settings.steps
                );
            }
            self.assign()?;
            self.task.resumed();
            println!("resumes after step {done} from {}", checkpoint.display());
        } else {
            expect_nothing_to_overwrite(&self.settings.out, self.task.files())?;
        }
        self.journal = Journal::resume(
            &self.settings.out,
            self.task.name(),
            self.optimiser.steps_taken(),
        )?;
        Ok(())
    }

    fn assign(&mut self) -> Result<()> {
        self.task.assign(&mut self.optimiser.weights())?;
        self.task.assign_averaged(&mut self.optimiser.averaged())
    }

    fn announce(&self) {
        let count = self.optimiser.parameter_count();
        // Weights, two moments, the average, and the gradient.
        let mib = (count * 5 * size_of::<f32>()) as f64 / f64::from(1 << 20);
        println!(
            "{}: {:.2} M parameters, {mib:.0} MiB for them and the optimiser, {} steps",
            self.task.name(),
            count as f64 / 1e6,
            self.settings.steps,
        );
    }

    /// Takes one step; returns its message.
    fn step(&mut self) -> Result<String> {
        let step = self.optimiser.steps_taken();
        let rate = self.settings.schedule.at(step);
        let found = self.task.step(step)?;
        let taken = if found.loss.is_finite() {
            self.optimiser.step(&found.gradient, rate)
        } else {
            Err(OptimiserError::NotFinite {
                step,
                norm: f64::from(found.loss),
                parameter: "the loss itself".into(),
            })
        };
        match taken {
            Ok(norm) => {
                self.in_a_row = 0;
                self.assign()?;
                self.journal.step(step, &found, norm, rate);
                self.events.step(step, &found, norm, rate)?;
                let loss = self.journal.recent_mean(50);
                Ok(format!("loss {loss:.4} |g| {norm:.2}"))
            }
            Err(error @ OptimiserError::NotFinite { .. }) => {
                self.in_a_row += 1;
                if self.in_a_row == MOST_SKIPPED {
                    let kept = match self.checkpoint().is_file() {
                        true => format!(
                            "the last good checkpoint is {}",
                            self.checkpoint().display()
                        ),
                        false => "there was no checkpoint yet".to_owned(),
                    };
                    return Err(error).context(format!(
                        "{MOST_SKIPPED} steps in a row are not finite; {kept}; a lower learning rate may help"
                    ));
                }
                self.optimiser.skip();
                let skipped = self.optimiser.steps_skipped();
                Ok(format!(
                    "step {step} is not finite: skipped ({skipped} so far)"
                ))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// Writes checkpoint and journal, except while steps are skipped, to keep the earlier state; returns whether it
    /// did.
    fn save(&mut self) -> Result<bool> {
        if self.in_a_row > 0 {
            return Ok(false);
        }
        let checkpoint = self.checkpoint();
        self.optimiser.save(&checkpoint, &self.settings.identity)?;
        self.journal.write(&self.settings.out)?;
        self.events.flush()?;
        Ok(true)
    }

    /// Writes the model, with the mark of an unfinished one until the last step.
    fn write(&mut self) -> Result<()> {
        let (out, name) = (&self.settings.out, self.task.name());
        let (step, steps) = (self.optimiser.steps_taken(), self.settings.steps);
        if step < steps {
            let part = name.to_owned();
            Unfinished { part, step, steps }.write(out)?;
        }
        self.task.write(&mut self.optimiser.averaged(), out)?;
        if step >= steps {
            Unfinished::remove(out, name)?;
        }
        self.has_written = true;
        Ok(())
    }

    /// Writes and measures the model; returns a message.
    fn validate(&mut self, is_last: bool) -> Result<String> {
        self.write()?;
        let figures = self.task.validate(is_last)?;
        let step = self.optimiser.steps_taken();
        let mut line = format!("step {step}, loss {:.4}", self.journal.recent_mean(200));
        for Figure { name, value } in &figures {
            line += &format!(", {name} {value:.3}");
        }
        self.events.validated(step, &figures)?;
        self.journal.validated(step, figures);
        self.journal.write(&self.settings.out)?;
        if let Some(picture) = self.task.samples()? {
            let folder = self
                .settings
                .out
                .join(format!("{}.samples", self.task.name()));
            std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            let path = folder.join(format!("step_{step:07}.png"));
            picture
                .save(&path)
                .with_context(|| path.display().to_string())?;
            self.events.picture(step, &picture)?;
        }
        self.events.flush()?;
        Ok(line)
    }
}

#[cfg(test)]
pub(crate) mod tests;
