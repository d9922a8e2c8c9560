//! The trials of all tasks, one per unit.

use std::path::Path;

use crate::judges::Rollout;
use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use wm_metrics::ranking::SUCCESS_THRESHOLD;

use super::{
    Condition, Setup, Verdicts,
    actor::still,
    episode::{Imagination, Start, Trial, imagine},
    judging::JudgePanel,
    setup::Policy,
    tasks::{Task, choose},
};
use crate::{CONTEXT, Settings, Shard, Subject, picture_strip::strip_of};

/// Result of one trial.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImaginedTrial {
    /// Name of the task.
    pub task: String,
    /// Trial, from 0.
    pub trial: usize,
    /// Condition.
    pub condition: Condition,
    /// Instruction for the policy.
    pub instruction: String,
    /// Level of difficulty with its name, if a tasks file has it.
    pub level: Option<(u8, String)>,
    /// Probability of success on the imagined latents; `None` without a probe for the instruction.
    pub probe: Option<f32>,
    /// The same on the latents of the recorded frames, for the recorded policy.
    pub probe_on_frames: Option<f32>,
    /// Whether the recording was a success, for the recorded policy.
    pub outcome: Option<bool>,
    /// Verdicts of the judges, if any.
    pub verdicts: Option<Verdicts>,
    /// Clipped values of actions.
    pub clipped: usize,
    /// Values of all actions.
    pub values: usize,
    /// The policy's pictures as a PNG in base64, if the report shows them.
    pub strip: Option<String>,
}

impl ImaginedTrial {
    /// Whether a judge calls the trial a success; `None` without its score.
    pub(super) fn success_by(&self, judge: &str) -> Option<bool> {
        let score = self.verdicts.as_ref()?.scores.get(judge)?;
        score.map(|score| score >= SUCCESS_THRESHOLD)
    }
}

/// A trial to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Unit {
    task: usize,
    condition: Condition,
    trial: usize,
}

/// The trials of all tasks.
pub struct Trials<'a> {
    subject: &'a Subject,
    settings: &'a Settings,
    setup: &'a Setup,
    tasks: Vec<Task>,
    units: Vec<Unit>,
    judging: Option<JudgePanel>,
}

impl<'a> Trials<'a> {
    /// Chooses the tasks, and opens the earlier answers of the judges in the records folder.
    ///
    /// # Errors
    /// If no requested task exists, pictures are needed and the model has no decoder, or the judges are unusable.
    pub fn new(
        subject: &'a Subject,
        settings: &'a Settings,
        setup: &'a Setup,
        records: (&Path, Shard),
    ) -> Result<Self> {
        let blind = setup.judges.is_none() && !matches!(setup.policy, Policy::Command(_));
        anyhow::ensure!(
            blind || subject.decoder.is_some(),
            "the model has no decoder, but programs and judges need pictures"
        );
        let tasks = choose(subject, setup, settings.policy.tasks)?;
        let units = units(&tasks, setup, settings.policy.trials);
        let judging = setup.judges.clone();
        let judging = judging.map(|(panel, prompts)| JudgePanel::open(panel, prompts, records));
        Ok(Self {
            subject,
            settings,
            setup,
            tasks,
            units,
            judging: judging.transpose()?,
        })
    }

    /// Names of the units.
    #[must_use]
    pub fn names(&self) -> Vec<String> {
        let units = self.units.iter().filter_map(|unit| {
            let task = self.tasks.get(unit.task)?;
            let end = unit.condition.suffix();
            Some(format!("{} trial {}{end}", task.name, unit.trial))
        });
        units.collect()
    }

    /// Runs one trial.
    ///
    /// # Errors
    /// If the policy or a judge fails, or model and data do not fit.
    pub fn measure(&self, unit: usize) -> Result<ImaginedTrial> {
        let Self { subject, setup, .. } = self;
        let own = &self.settings.policy;
        let found = self.units.get(unit);
        let found = found.and_then(|unit| Some((*unit, self.tasks.get(unit.task)?)));
        let (unit, task) = found.context("no such unit")?;
        let Unit {
            task: number,
            condition,
            trial,
        } = unit;
        let start = self.start(task, condition)?;
        let is_shown = trial == 0 && number < own.strips && subject.decoder.is_some();
        let trial_of = self.trial_of(task, unit);
        let instruction = trial_of.instruction;
        let is_seen = is_shown || self.judging.is_some();
        let episode = imagine(
            imagination(subject),
            &setup.policy,
            &start,
            trial_of,
            (own.steps, is_seen),
        )?;
        let strip = is_shown
            .then(|| strip_of(&[&episode.pictures]))
            .transpose()?;
        let is_recording =
            matches!(setup.policy, Policy::Recorded) && condition == Condition::Recorded;
        let verdicts = if setup.has_probes_judge() {
            Some(self.verdicts_by_probes(&episode.latents, instruction))
        } else {
            self.judging.as_ref().map(|judging| {
                judging.judge(&Rollout {
                    instruction: instruction.to_owned(),
                    // They belong to the recorded instruction.
                    partial_criteria: match condition {
                        Condition::OtherInstruction => None,
                        _ => task.partial_criteria.clone(),
                    },
                    frames: episode.pictures,
                    trial: trial as u64,
                    stamp_ns: 0,
                })
            })
        };
        let probability = |latents: &Tensor| self.probability(latents, instruction);
        let real = is_recording.then(|| {
            let frames = subject.frames_of(task.episode, own.steps);
            probability(&subject.recording(task.episode, frames.len())?.frames)
        });
        let outcome = subject.dataset.episodes().get(task.episode);
        Ok(ImaginedTrial {
            task: task.name.clone(),
            trial,
            condition,
            instruction: instruction.to_owned(),
            level: task.level.clone(),
            probe: probability(&episode.latents)?,
            probe_on_frames: real.transpose()?.flatten(),
            outcome: outcome.and_then(|own| own.success).filter(|_| is_recording),
            verdicts: verdicts.transpose()?,
            clipped: episode.clipped,
            values: episode.values,
            strip,
        })
    }

    fn trial_of<'t>(&self, task: &'t Task, unit: Unit) -> Trial<'t> {
        Trial {
            task: &task.name,
            trial: unit.trial,
            seed: seed(self.settings.seed, &task.name, unit.trial),
            instruction: task.instruction_under(unit.condition),
        }
    }

    /// Every success probe as a judge: 0 or 1, `None` for an instruction that it does not know.
    fn verdicts_by_probes(&self, latents: &Tensor, instruction: &str) -> Result<Verdicts> {
        let mut verdicts = Verdicts::default();
        for probe in &self.subject.readers.probes {
            let score = match probe.model.instruction(instruction) {
                Ok(instruction) => {
                    let latents = probe.latents(latents)?;
                    let success = probe.model.probability(&latents, &instruction)?;
                    Some(f64::from(success > 0.5))
                }
                Err(_) => None,
            };
            verdicts.scores.insert(probe.name.clone(), score);
        }
        Ok(verdicts)
    }

    /// `None` without a probe for the instruction.
    fn probability(&self, latents: &Tensor, instruction: &str) -> Result<Option<f32>> {
        let Some(probe) = self.subject.probe() else {
            return Ok(None);
        };
        let Ok(instruction) = probe.instruction(instruction) else {
            return Ok(None);
        };
        Ok(Some(probe.probability(latents, &instruction)?))
    }

    /// Latents of the recorded frames and actions of a unit, for tests.
    #[cfg(test)]
    pub(super) fn latents(&self, unit: usize, steps: usize) -> Result<Tensor> {
        let unit = self.units.get(unit).context("no such unit")?;
        let task = self.tasks.get(unit.task).context("no such task")?;
        let start = self.start(task, unit.condition)?;
        let trial_of = self.trial_of(task, *unit);
        let found = imagine(
            imagination(self.subject),
            &self.setup.policy,
            &start,
            trial_of,
            (steps, false),
        );
        Ok(found?.latents)
    }

    fn start(&self, task: &Task, condition: Condition) -> Result<Start> {
        let subject = self.subject;
        let encoding = &subject.world.encoding;
        let skip = encoding.frame_skip();
        let episodes = subject.dataset.episodes();
        let own = episodes.get(task.episode).context("no such episode")?;
        let begin = (CONTEXT - 1) * skip;
        let (before, recorded) = own.actions.split_at(begin.min(own.actions.len()));
        let last = before.last().context("an action before the newest frame")?;
        let recorded = recorded.to_vec();
        let images = self.setup.start_images.as_ref();
        if let (Condition::OtherFrame, Some(images)) = (condition, images) {
            // With one frame only, the robot rests between it and itself.
            let picture = images.picture(&task.name, subject.dataset.framing())?;
            let latent = subject.encode(std::slice::from_ref(&picture))?;
            let last = still(last, encoding.space());
            let rest = encoding.encode_step(&vec![last.clone(); skip])?.values;
            let past = Tensor::from_vec(rest, (1, encoding.action_dim()), &Device::Cpu)?;
            return Ok(Start {
                latents: Tensor::cat(&[&latent; CONTEXT], 0)?.unsqueeze(0)?,
                past: Tensor::cat(&[&past; CONTEXT - 1], 0)?,
                picture,
                last,
                recorded,
            });
        }
        let observed = subject.recording(task.episode, CONTEXT)?;
        Ok(Start {
            latents: observed.frames.unsqueeze(0)?,
            past: observed.actions.narrow(0, 0, CONTEXT - 1)?,
            picture: subject.frame(own.first_frame + begin)?,
            last: last.clone(),
            recorded,
        })
    }
}

fn imagination(subject: &Subject) -> Imagination<'_> {
    Imagination {
        world: &subject.world,
        sampler: subject.sampler(),
        decoder: subject.decoder.as_deref(),
        views: subject.dataset.views(),
    }
}

/// By task, then by condition.
fn units(tasks: &[Task], setup: &Setup, trials: usize) -> Vec<Unit> {
    let tasks = tasks.iter().enumerate();
    let conditions = tasks.flat_map(|(task, own)| {
        own.conditions(setup)
            .map(move |condition| (task, condition))
    });
    let units = conditions.flat_map(|(task, condition)| {
        (0..trials.max(1)).map(move |trial| Unit {
            task,
            condition,
            trial,
        })
    });
    units.collect()
}

/// Seed of a trial: equal for all conditions, independent of other tasks, and below 2^53, where integers in JSON are
/// exact.
pub(super) fn seed(of_all: u64, task: &str, trial: usize) -> u64 {
    let mut hash = Sha256::new();
    hash.update(of_all.to_le_bytes());
    hash.update((trial as u64).to_le_bytes());
    hash.update(task);
    let bytes: [u8; 32] = hash.finalize().into();
    let first = bytes.iter().take(8);
    first.fold(0_u64, |seed, byte| (seed << 8) | u64::from(*byte)) >> 11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_depend_on_seed_task_and_trial() {
        let known = [
            seed(0, "a", 0),
            seed(0, "a", 1),
            seed(0, "b", 0),
            seed(1, "a", 0),
        ];
        for (index, one) in known.iter().enumerate() {
            assert!(*one < 1 << 53);
            assert!(!known.iter().skip(index + 1).any(|other| other == one));
        }
        assert_eq!(seed(0, "a", 0), seed(0, "a", 0));
    }
}
