//! Distillation of a transition model that is sampled with ten Euler steps into one that takes one or two.
//!
//! Notation: a frame z, noise eps, x_t = (1 - t) z + t eps at noise level t. v(x, t | h) is a model's velocity after
//! the history h, and M(x, t, s | h) = x - (t - s) v(x, t | h) the end of its straight line at a lower level s. A step
//! of the sampler is x_s = M(x_t, t, s | h). phi is the teacher, theta the student, theta' the average of its weights.
//! 1 = l_0 > l_1 > ... > l_S = 0 are the levels of the student's sampler, and s(t) is the highest of them below t.
//!
//! **Causal consistency distillation**, frame by frame (Causal Forcing++, arXiv 2605.15141; consistency distillation of
//! Song et al., arXiv 2303.01469, in segments as the multistep consistency models of Heek et al., arXiv 2403.06807). For
//! neighbouring levels t > u of the teacher's sampler, a frame z of a clip and the real frames h before it:
//!
//! ```text
//! x_u  = M_phi(x_t, t, u | h)                                      one step of the teacher, no gradient
//! goal = M_theta'(x_u, u, s(t) | h)   for u > 0, which is x_u for u = s(t);    z   for u = 0
//! loss = H(M_theta(x_t, t, s(t) | h) - goal),    H(e) = sqrt(mean e^2 + c^2) - c
//! ```
//!
//! With one step, s(t) is always 0, and M(x, t, 0) is the model's clean frame. All frames of a clip are learned at
//! once, each at its own level and after clean frames, as in the sampler.
//!
//! **Self-forcing** (Huang et al., arXiv 2506.08009) against drift, for a share of the clips of a second stage: the
//! student predicts a few frames h' from its own predictions, then one more, G_theta(eps | h'), with its own sampler:
//!
//! ```text
//! loss = r mean |G_theta(eps | h') - z|^2 + (1 - r) H(G_theta(eps | h') - G_phi(eps | h'))
//! ```
//!
//! with the teacher's sampler G_phi from the same noise and history. Only the last prediction has a gradient. The first
//! part draws predictions towards the mean of possible futures, which lowers their error but removes unpredictable
//! motion: hence a small r, and motion among the gate's figures. The second part maps each noise to one frame, without
//! this effect; squared instead of H, it would have it wherever the student cannot follow the teacher exactly.
//!
//! Without the teacher's step (x_u from the real frame and the same noise, as in consistency training or a mean flow to
//! fixed ends), few-step students of a toy drift far more. With the teacher's whole path instead of one step, they are
//! no better over a rollout, at several times the cost. Shortcut models (arXiv 2410.12557) and mean flows (arXiv
//! 2505.13447) for any number of steps need the step's length as an input, which the network lacks.

mod arguments;
mod consistency;
mod gate;
mod levels;
mod recipe;
mod self_forcing;
mod teacher;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::Tensor;
use rand::Rng as _;
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use wm_dataset::{ClipSource, Latents};
use wm_evaluation::{ActionChange, Figure, Windows};
use wm_model::{
    Weights,
    transition::{CONFIG_KEY, Transition, WeightGradients},
};
use wm_zoo::idm::TrainedIdm;

use crate::{
    arguments::RunArgs,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::{Parameter, ParameterValues},
    recipe::Recipe as _,
    run::{RunEnd, Stop, Task},
    trained_weights::trained_weights_of_actions,
    transition::{Batch, FILE, HORIZON, Objective, QUICK_WINDOWS, table_row},
    workers::BatchLoss,
};
pub use arguments::TrainDistillArgs;
use consistency::Steps;
use gate::{Measurement, Verdict};
use levels::Levels;
pub use recipe::{ConsistencyRecipe, DistillRecipe, GateRecipe, SelfForcingRecipe};
use self_forcing::OwnHistory;
use teacher::Teacher;

/// File of the student until it passes the gate.
const CANDIDATE: &str = "transition.candidate.safetensors";
/// File of a student that fails the gate.
const REJECTED: &str = "transition.rejected.safetensors";
/// Metadata key of a student's origin, as JSON.
const DISTILLED_KEY: &str = "distilled";

/// Evaluation data of a student.
struct GateData<'a> {
    held_out: Option<&'a Latents>,
    idm: Option<&'a TrainedIdm>,
    /// Whether to keep it in any case.
    accept: bool,
}

fn train_on(
    run: &RunArgs,
    recipe: &DistillRecipe,
    teacher: &Teacher,
    train: &Latents,
    gated: &GateData<'_>,
    stop: &Stop,
) -> Result<RunEnd> {
    ensure!(
        gated.held_out.is_some() || gated.accept,
        "no episodes for validation: the student cannot be measured; keep it unmeasured with --accept"
    );
    if let (Some(idm), Some(held_out)) = (gated.idm, gated.held_out) {
        let context = "the inverse dynamics model's latents are not the data's";
        idm.space().require(held_out.space()).context(context)?;
    }
    let mut task = DistillTask::new(recipe, teacher, train, gated.held_out, run)?;
    let samples = task.clips.len();
    let per_epoch = recipe.course().per_epoch(samples);
    task.self_forcing_after = run.length(recipe.self_forcing.after, per_epoch);
    let data = [
        ("self_forcing_after", json!(task.self_forcing_after)),
        ("teacher", json!(teacher.sha256())),
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("actions", json!(teacher.encoding)),
    ];
    let mut settings = run.settings(recipe, samples, data)?;
    // It determines whether the student is kept, not its weights.
    if let Some(Value::Object(recipe)) = settings.identity.get_mut("recipe") {
        recipe.remove("gate");
    }
    if let Some(held_out) = &task.held_out {
        let row = table_row(&held_out.teacher);
        println!("squared latent error / persistence of the teacher, k = 1 to {HORIZON}: {row}");
    }
    let about = format!("{} episodes, {} threads", task.clips.len(), run.threads()?);
    let ended = run.train(&mut task, recipe, &settings, (&about, stop))?;
    if ended == RunEnd::Finished {
        judge(&run.out, recipe, teacher, gated)?;
    }
    Ok(ended)
}

/// Measures the student in `out` against its teacher, and renames its file by the verdict.
fn judge(
    out: &Path,
    recipe: &DistillRecipe,
    teacher: &Teacher,
    gated: &GateData<'_>,
) -> Result<()> {
    let candidate = out.join(CANDIDATE);
    let named = |name: &str| {
        let path = out.join(name);
        std::fs::rename(&candidate, &path).with_context(|| path.display().to_string())?;
        println!("wrote {}", path.display());
        anyhow::Ok(())
    };
    let Some(held_out) = gated.held_out else {
        return named(FILE);
    };
    let student = Transition::from_weights(Weights::open(&candidate)?)?;
    let evaluation = Windows::new(held_out, &teacher.encoding, HORIZON, usize::MAX)?;
    let measurement = Measurement {
        evaluation: &evaluation,
        encoding: &teacher.encoding,
        idm: gated.idm,
        plans: recipe.gate.plans,
    };
    let figures = [
        measurement.of(&student.pack()?)?,
        measurement.of(&teacher.pack()?)?,
        measurement.of(&teacher.hurried(recipe.steps)?)?,
    ];
    let verdict = Verdict::new(evaluation.len(), &figures, &recipe.gate);
    println!("{verdict}");
    let path = out.join("distill.gate.json");
    std::fs::write(&path, serde_json::to_vec_pretty(&verdict)?)
        .with_context(|| path.display().to_string())?;
    if verdict.passes() || gated.accept {
        return named(FILE);
    }
    named(REJECTED)?;
    verdict.require()
}

/// Networks of a distillation; the first one has gradients.
struct Networks<'a> {
    student: &'a Transition,
    /// The student with averaged weights.
    target: &'a Transition,
    teacher: &'a Transition,
}

/// Held-out windows, and the teacher's figures on them.
struct HeldOut {
    evaluation: Windows,
    teacher: Vec<f64>,
}

/// A student in training.
struct DistillTask<'a> {
    recipe: &'a DistillRecipe,
    teacher: &'a Teacher,
    objective: Objective,
    levels: Levels,
    /// Step at which self-forcing starts.
    self_forcing_after: u64,
    clips: ClipSource<'a>,
    held_out: Option<HeldOut>,
    variables: NetworkVariables,
    student: Transition,
    target: Transition,
    /// The student written last.
    written: Option<Transition>,
}

impl<'a> DistillTask<'a> {
    fn new(
        recipe: &'a DistillRecipe,
        teacher: &'a Teacher,
        train: &'a Latents,
        held_out: Option<&Latents>,
        run: &RunArgs,
    ) -> Result<Self> {
        let (variables, student) = teacher.student(recipe.steps)?;
        let config = student.config();
        let levels = Levels::new(teacher.sampler(), &config.sampler)?;
        let held_out = held_out.map(|latents| {
            let evaluation = Windows::new(latents, &teacher.encoding, HORIZON, QUICK_WINDOWS)
                .context("the episodes for validation")?;
            let packed = teacher.pack()?;
            anyhow::Ok(HeldOut {
                teacher: evaluation.ratios(&packed, ActionChange::None)?,
                evaluation,
            })
        });
        Ok(Self {
            objective: recipe.objective(config)?,
            levels,
            self_forcing_after: 0,
            clips: ClipSource::new(train, &teacher.encoding, config.max_frames)?.on(&run.device()?),
            held_out: held_out.transpose()?,
            target: teacher.target(
                config,
                &mut variables.parameters(|_| 0)?.iter().map(as_trained),
            )?,
            recipe,
            teacher,
            variables: NetworkVariables::new(variables, recipe, run)?,
            student,
            written: None,
        })
    }

    fn networks(&self) -> Networks<'_> {
        Networks {
            student: &self.student,
            target: &self.target,
            teacher: &self.teacher.model,
        }
    }

    /// Loss of one small batch of random clips.
    fn loss(&self, student: &Transition, step: u64, rng: &mut ChaCha8Rng) -> Result<Tensor> {
        let (own, networks) = (&self.recipe.self_forcing, self.networks());
        let (objective, clips) = (&self.objective, &self.clips);
        let huber = self.recipe.huber;
        if step >= self.self_forcing_after && rng.random_bool(own.share) {
            let sampler = self.teacher.sampler();
            let history = OwnHistory::draw(&networks, sampler, objective, own, clips, rng)?;
            return history.loss(student, own.real, huber);
        }
        let own = &self.recipe.consistency;
        let batch = Batch::draw(objective, &self.student, clips, rng)?;
        let steps = Steps::draw(&networks, batch, own.history, &self.levels, rng)?;
        steps.loss(student, huber)
    }
}

fn as_trained(parameter: &Parameter) -> ParameterValues<'_> {
    ParameterValues {
        name: &parameter.name,
        shape: &parameter.shape,
        values: &parameter.values,
    }
}

impl NetworkLearner for DistillTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        let gradients = WeightGradients::default();
        let student = self.student.collecting(&gradients);
        Ok(BatchLoss {
            gradients,
            ..BatchLoss::from(self.loss(&student, step, rng)?)
        })
    }

    fn follow_averaged(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
    ) -> Result<()> {
        self.target = self.teacher.target(self.student.config(), averaged)?;
        Ok(())
    }
}

impl Task for DistillTask<'_> {
    fn name(&self) -> &'static str {
        "distill"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE, REJECTED]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let teacher = self.teacher;
        let config = (CONFIG_KEY, self.student.config());
        let mut weights =
            trained_weights_of_actions(averaged, config, &teacher.space, &teacher.encoding)?;
        let distilled = json!({"teacher": teacher.sha256(), "steps": teacher.sampler().steps});
        weights.metadata(DISTILLED_KEY, distilled.to_string());
        let path = folder.join(CANDIDATE);
        weights.write(&path)?;
        // From exactly the written file.
        self.written = Some(Transition::from_weights(Weights::open(&path)?)?);
        Ok(())
    }

    fn validate(&mut self, _: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(student)) = (&self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let student = student.pack()?;
        let ratios = held_out.evaluation.ratios(&student, ActionChange::None)?;
        let named = |name: &'static str, ratios: Vec<f64>| {
            let figures = (1..).zip(ratios);
            figures.map(move |(k, ratio)| Figure::new(format!("{name}_k{k}"), ratio))
        };
        let teacher = named("teacher", held_out.teacher.clone());
        Ok(named("ratio", ratios).chain(teacher).collect())
    }
}

#[cfg(test)]
mod tests;
