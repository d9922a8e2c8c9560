//! Training of the transition model on the latents of a frozen encoder.
//!
//! Flow matching on clips of model steps: the first frames are history, the later ones are learned, each at its own
//! random noise level. By the recipe, they see clean predecessors (teacher forcing), or each other's noisy frames
//! (diffusion forcing, the paper's). A step's clips are split into small batches whose activations stay in cache; see
//! `Workers`.

mod arguments;
mod draws;
mod noised_at_once;
mod object_weights;
mod objective;
mod recipe;
mod worker;

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use candle_core::DType;
use image::RgbImage;
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use wm_dataset::{ClipSource, Dataset, Latents};
use wm_evaluation::{ActionChange, Figure, PictureErrors, Windows, recover_actions, strip};
use wm_model::{
    Decoder, Weights,
    trained_folder::TRAINED_ON_KEY,
    transition::{
        ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition, TransitionConfig, WeightGradients,
    },
};
use wm_motion::actions::ActionEncoding;
use wm_zoo::{ModelFolder, TransitionTensors};

use crate::{
    arguments::RunArgs,
    fresh_weights::FreshWeights,
    network_variables::{NetworkLearner, NetworkVariables},
    optimiser::ParameterValues,
    recipe::Override,
    run::{RunEnd, Stop, Task},
    trained_weights::trained_weights_of_actions,
    workers::BatchLoss,
};
pub use arguments::{EvaluateTransitionArgs, ListenArgs, TrainTransitionArgs, TrainWorkerArgs};
use object_weights::ObjectWeights;
pub(crate) use objective::{Batch, normals};
pub use objective::{Forcing, Objective, ObjectiveRecipe, TauDistribution};
pub use recipe::{ModelRecipe, SamplerRecipe, TransitionRecipe};
use worker::Setup;

/// Predicted model steps of an evaluation.
pub(crate) const HORIZON: usize = 8;
/// Windows of evaluations during the training.
pub(crate) const QUICK_WINDOWS: usize = 32;
/// File of the weights in a model's folder.
pub(crate) const FILE: &str = "transition.safetensors";

impl TrainTransitionArgs {
    /// Trains until the last step, or until `stop` is set.
    ///
    /// # Errors
    /// If data, recipe, checkpoint or weights cannot be read or written, or the training diverges.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let recipe: TransitionRecipe = self.on.run.load_recipe([])?;
        self.listen.check()?;
        let (folder, on) = self.on.open()?;
        if let Some(remark) = on.data.training.scale_remark()? {
            tracing::warn!("{remark}");
        }
        let decoder = folder.decoder()?;
        let pictures = decoder.as_deref().zip(on.data.validation.as_ref());
        let held_out = on.held_out.as_ref().map(|latents| (latents, pictures));
        let run = &self.on.run;
        let from = run.from.as_deref();
        let from = from.map(|from| ModelFolder::open(from)?.transition_tensors());
        let from = from.transpose()?;
        let listen = &self.listen;
        let train = (&on.train, Some(&on.data.training));
        train_on(run, &recipe, from, train, held_out, (listen, stop))
    }
}

/// A decoder of latents, and their frames.
pub(crate) type Pictures<'a> = (&'a dyn Decoder, &'a Dataset);

pub(crate) fn train_on(
    run: &RunArgs,
    recipe: &TransitionRecipe,
    from: Option<TransitionTensors>,
    (train, frames): (&Latents, Option<&Dataset>),
    held_out: Option<(&Latents, Option<Pictures<'_>>)>,
    (listen, stop): (&ListenArgs, &Stop),
) -> Result<RunEnd> {
    let recipe = &recipe.of_views(train.views())?;
    let (encoding, config) = match &from {
        None => {
            let encoding = recipe.encoding(train.action_space())?;
            let config = recipe.config(train.space(), &encoding)?;
            (encoding, config)
        }
        Some(from) => tuned(from, train, (recipe, &run.set))?,
    };
    let old = from.map(|from| from.tensors).unwrap_or_default();
    let fresh = FreshWeights::tuning(recipe.seed, old).on(&run.compute()?)?;
    let setup = Setup::new(recipe, &encoding, &config, run);
    let data = (train, frames);
    let mut task = TransitionTask::new(recipe, (&encoding, config), fresh, data, held_out, run)?;
    if let Some(address) = &listen.listen {
        let processes = (run.threads()?, listen.workers);
        task.variables.coordinator = Some(setup.listen(address, train, processes)?);
    }
    let data = [
        ("latent_space", json!(train.space().to_string())),
        ("data", json!(train.digest())),
        ("actions", json!(task.encoding)),
    ];
    let data = (task.clips.len(), data);
    let ended = run.train_on_clips(&mut task, recipe, data, stop)?;
    if let Some(coordinator) = task.variables.coordinator.take() {
        coordinator.end(ended.into());
    }
    Ok(ended)
}

/// Held-out latents, and some windows of them.
struct HeldOut<'a> {
    latents: &'a Latents,
    quick: Windows,
    pictures: Option<Pictures<'a>>,
}

/// A transition model in training.
struct TransitionTask<'a> {
    config: TransitionConfig,
    encoding: &'a ActionEncoding,
    objective: Objective,
    train: &'a Latents,
    clips: ClipSource<'a>,
    objects: Option<ObjectWeights<'a>>,
    held_out: Option<HeldOut<'a>>,
    variables: NetworkVariables,
    model: Transition,
    /// The model written last.
    written: Option<Transition>,
}

impl<'a> TransitionTask<'a> {
    fn new(
        recipe: &TransitionRecipe,
        (encoding, config): (&'a ActionEncoding, TransitionConfig),
        fresh: FreshWeights,
        (train, frames): (&'a Latents, Option<&'a Dataset>),
        held_out: Option<(&'a Latents, Option<Pictures<'a>>)>,
        run: &RunArgs,
    ) -> Result<Self> {
        let model = trainable(&config, &fresh, recipe.seed)?;
        Ok(Self {
            objective: recipe.objective(&config)?,
            clips: ClipSource::new(train, encoding, config.max_frames)?.on(&run.device()?),
            objects: ObjectWeights::new(frames, recipe.objective.object_weight)?,
            config,
            encoding,
            train,
            held_out: match held_out {
                Some((latents, pictures)) => Some(HeldOut {
                    latents,
                    pictures,
                    quick: Windows::new(latents, encoding, HORIZON, QUICK_WINDOWS)
                        .context("the held-out bags")?,
                }),
                None => None,
            },
            variables: NetworkVariables::fresh(fresh, recipe, run)?,
            model,
            written: None,
        })
    }
}

impl NetworkLearner for TransitionTask<'_> {
    fn variables(&self) -> &NetworkVariables {
        &self.variables
    }

    fn batch_loss(&self, _step: u64, rng: &mut ChaCha8Rng) -> Result<BatchLoss> {
        let gradients = WeightGradients::default();
        let model = self.model.collecting(&gradients);
        let clips = (&self.clips, self.objects.as_ref());
        let loss = self.objective.loss(&model, clips, rng)?;
        Ok(BatchLoss {
            gradients,
            ..BatchLoss::from(loss)
        })
    }
}

impl Task for TransitionTask<'_> {
    fn name(&self) -> &'static str {
        "transition"
    }

    fn files(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn write(
        &mut self,
        averaged: &mut dyn Iterator<Item = ParameterValues<'_>>,
        folder: &Path,
    ) -> Result<()> {
        let (config, space) = ((CONFIG_KEY, &self.config), self.train.space());
        let path = folder.join(FILE);
        let mut weights = trained_weights_of_actions(averaged, config, space, self.encoding)?;
        if let Some(size) = self.train.picture_size() {
            weights.metadata(TRAINED_ON_KEY, json!(size).to_string());
        }
        weights.write(&path)?;
        // From exactly the written file.
        self.written = Some(Transition::from_weights(Weights::open(&path)?)?);
        Ok(())
    }

    fn validate(&mut self, thorough: bool) -> Result<Vec<Figure>> {
        let (Some(held_out), Some(model)) = (&self.held_out, &self.written) else {
            return Ok(Vec::new());
        };
        let model = model.pack()?;
        let ratios = if thorough {
            Windows::new(held_out.latents, self.encoding, HORIZON, usize::MAX)?
                .ratios(&model, ActionChange::None)?
        } else {
            held_out.quick.ratios(&model, ActionChange::None)?
        };
        let figures = (1..).zip(ratios);
        Ok(figures
            .map(|(k, ratio)| Figure::new(format!("ratio_k{k}"), ratio))
            .collect())
    }

    fn samples(&mut self) -> Result<Option<RgbImage>> {
        let (Some(held_out), Some(model)) = (&self.held_out, &self.written) else {
            return Ok(None);
        };
        let Some((decoder, dataset)) = held_out.pictures else {
            return Ok(None);
        };
        strip(&held_out.quick, &model.pack()?, decoder, dataset).map(Some)
    }
}

impl EvaluateTransitionArgs {
    /// Prints latent errors relative to persistence for true, negated, zero and shuffled actions, the PSNR of decoded
    /// pictures against persistence, and the recovery of actions by planning.
    ///
    /// # Errors
    /// If data or weights cannot be read.
    pub fn run(&self) -> Result<()> {
        let (folder, dataset, latents) = self.on.open()?;
        let weights = Weights::open(&self.weights)?;
        let actions: ActionEncoding = weights.json(ACTIONS_KEY)?;
        let space: wm_model::LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        space.require(latents.space())?;
        actions
            .space()
            .expect_same(latents.action_space(), "the model", "the bags")?;
        let model = Transition::from_weights(weights)?.pack()?;
        let evaluation = Windows::new(&latents, &actions, HORIZON, self.windows)?;
        println!(
            "{} windows; squared latent error / persistence",
            evaluation.len()
        );
        println!(
            "{:<16} {}",
            "action",
            (1..=HORIZON)
                .map(|k| format!("k={k:<5}"))
                .collect::<String>()
        );
        for change in [
            ActionChange::None,
            ActionChange::Negated,
            ActionChange::Zero,
            ActionChange::Shuffled,
        ] {
            let ratios = evaluation.ratios(&model, change)?;
            println!("{:<16} {}", change.to_string(), table_row(&ratios));
        }
        for steps in self.sampling_steps.iter().copied() {
            let mut sampler = model.config().sampler.clone();
            sampler.steps = steps;
            let ratios = evaluation.ratios_with(&model, &sampler, ActionChange::None)?;
            println!("{:<16} {}", format!("{steps} steps"), table_row(&ratios));
        }
        match folder.decoder()? {
            Some(decoder) => println!(
                "{}",
                PictureErrors::measure(&evaluation, &model, &*decoder, &dataset)?
            ),
            None => println!("no decoder: no pictures to measure"),
        }
        if self.plans > 0 {
            println!(
                "{}",
                recover_actions(&model, &actions, &evaluation, self.plans)?
            );
        }
        Ok(())
    }
}

/// Encoding and configuration of a model fine-tuned on `train`: its sizes and conventions stay, but blocks may be added.
fn tuned(
    from: &TransitionTensors,
    train: &Latents,
    (recipe, set): (&TransitionRecipe, &[Override]),
) -> Result<(ActionEncoding, TransitionConfig)> {
    // Weights do not depend on these, so they can be set; without that, they are the old model's, not the recipe's.
    let (mut frame_skip, mut accumulation) =
        (from.encoding.frame_skip(), from.encoding.accumulation());
    let (own, sizes) = (&recipe.model, &from.config);
    let mut depth = sizes.depth;
    for setting in set {
        let fits = match setting.path() {
            "model.frame_skip" => {
                frame_skip = own.frame_skip;
                true
            }
            "model.accumulation" => {
                accumulation = own.accumulation;
                true
            }
            "model.hidden" => own.hidden == Some(sizes.hidden),
            "model.depth" => {
                depth = own.depth.unwrap_or(depth);
                // Blocks that are added start as the identity.
                depth >= sizes.depth
            }
            "model.heads" => own.heads == Some(sizes.heads),
            "model.patch" => own.patch == Some(sizes.patch),
            "model.frames" => own.frames == sizes.max_frames,
            _ => true,
        };
        ensure!(
            fits,
            "--set {setting}: the model of --from has another value, which its weights determine"
        );
    }
    let (old, actions, space) = (&from.encoding, train.action_space(), train.space());
    let null = old.action_dim() - old.space().len();
    let encoding = ActionEncoding::new(
        actions.clone(),
        actions.len() + null,
        frame_skip,
        accumulation,
    )?;
    let config = TransitionConfig {
        depth,
        frame_skip,
        latent_height: space.height,
        latent_width: space.width,
        channels: space.channels,
        action_dim: encoding.action_dim(),
        // Positions have no weights, so further views need none.
        views: train.views(),
        ..from.config.clone()
    };
    config.validate()?;
    Ok((encoding, config))
}

/// A model whose tensors are variables.
pub(crate) fn trainable(
    config: &TransitionConfig,
    fresh: &FreshWeights,
    seed: u64,
) -> Result<Transition> {
    let model = Transition::build(config.clone(), &mut |parameter| {
        let (name, shape) = (&parameter.name, &parameter.shape);
        let initial = || parameter.initial(seed).map_err(candle_core::Error::wrap);
        Ok(fresh.variable(name, shape, initial)?)
    })?;
    Ok(in_its_format(model, fresh.dtype()))
}

/// The model on what computes with parameters of `dtype`: kernels take f32.
pub(crate) fn in_its_format(model: Transition, dtype: DType) -> Transition {
    match dtype {
        DType::F32 => model,
        _ => model.plain(),
    }
}

pub(crate) fn table_row(ratios: &[f64]) -> String {
    ratios.iter().map(|ratio| format!("{ratio:<7.3}")).collect()
}

#[cfg(test)]
pub(crate) mod tests;
