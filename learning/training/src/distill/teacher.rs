use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result};
use candle_core::{Device, Tensor};
use wm_dataset::Latents;
use wm_model::{
    Compute, Error, LatentSpace, Weights,
    sampler::Sampler,
    transition::{
        ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, LoadedTransition, Transition, TransitionConfig,
    },
};
use wm_motion::actions::ActionEncoding;

use crate::{
    optimiser::{Trained, Variables},
    transition::{FILE, in_its_format},
};

/// A trained transition model, and what it says of itself.
pub(super) struct Teacher {
    tensors: HashMap<String, Tensor>,
    sha256: String,
    pub(super) encoding: ActionEncoding,
    pub(super) space: LatentSpace,
    compute: Compute,
    /// Sampled with as many steps as the recipe asks for.
    pub(super) model: Transition,
}

impl Teacher {
    /// The file of a teacher that is given by its file or its folder.
    pub(super) fn file(path: &Path) -> PathBuf {
        if path.is_dir() {
            path.join(FILE)
        } else {
            path.to_owned()
        }
    }

    /// Reads the weights, to be sampled with `steps` steps, where `compute` computes.
    pub(super) fn open(file: &Path, steps: usize, compute: &Compute) -> Result<Self> {
        let read = || -> Result<Self> {
            let weights = Weights::open(file)?;
            let config: TransitionConfig = weights.json(CONFIG_KEY)?;
            let mut tensors = HashMap::new();
            let model = Transition::build(with_steps(config, steps), &mut |parameter| {
                let tensor = weights.tensor(&parameter.name, &parameter.shape)?;
                tensors.insert(parameter.name.clone(), tensor.clone());
                compute.tensor(&tensor, compute.dtype())
            })?;
            let model = in_its_format(model, compute.dtype());
            Ok(Self {
                encoding: weights.json(ACTIONS_KEY)?,
                space: weights.json(LATENT_SPACE_KEY)?,
                sha256: weights.sha256(),
                tensors,
                compute: compute.clone(),
                model,
            })
        };
        read().with_context(|| format!("the teacher {}", file.display()))
    }

    /// Checks that the latents and actions of `latents` are those that it was trained on.
    pub(super) fn require(&self, latents: &Latents) -> Result<()> {
        (self.space.require(latents.space()))
            .context("the teacher's latents are not the data's")?;
        (self.encoding.space()).expect_same(latents.action_space(), "the teacher", "the bags")?;
        Ok(())
    }

    pub(super) fn sampler(&self) -> &Sampler {
        &self.model.config().sampler
    }

    /// SHA-256 of its tensors.
    pub(super) fn sha256(&self) -> &str {
        &self.sha256
    }

    /// A model with its weights, to be trained for sampling with `steps` steps.
    pub(super) fn student(&self, steps: usize) -> Result<(Variables, Transition)> {
        let config = with_steps(self.model.config().clone(), steps);
        let mut variables = Variables::default();
        let model = Transition::build(config, &mut |parameter| {
            let initial = self.placed(&named(&self.tensors, &parameter.name)?)?;
            Ok(variables.add(&parameter.name, &initial)?)
        })?;
        Ok((variables, in_its_format(model, self.compute.dtype())))
    }

    /// The student of these weights, without gradients.
    pub(super) fn target(
        &self,
        config: &TransitionConfig,
        weights: &mut dyn Iterator<Item = Trained<'_>>,
    ) -> Result<Transition> {
        let mut tensors = HashMap::new();
        for weight in weights {
            let tensor = Tensor::from_slice(weight.values, weight.shape, &Device::Cpu)?;
            tensors.insert(weight.name.to_owned(), self.placed(&tensor)?);
        }
        let model = Transition::build(config.clone(), &mut |parameter| {
            named(&tensors, &parameter.name)
        })?;
        Ok(in_its_format(model, self.compute.dtype()))
    }

    /// Itself for inference.
    pub(super) fn pack(&self) -> Result<LoadedTransition> {
        self.hurried(self.sampler().steps)
    }

    /// The same, sampled with `steps` steps.
    pub(super) fn hurried(&self, steps: usize) -> Result<LoadedTransition> {
        let config = with_steps(self.model.config().clone(), steps);
        let model = Transition::build(config, &mut |parameter| {
            named(&self.tensors, &parameter.name)
        })?;
        Ok(model.pack()?)
    }

    fn placed(&self, tensor: &Tensor) -> wm_model::Result<Tensor> {
        self.compute.tensor(tensor, self.compute.dtype())
    }
}

fn named(tensors: &HashMap<String, Tensor>, name: &str) -> wm_model::Result<Tensor> {
    let tensor = tensors.get(name).cloned();
    tensor.ok_or_else(|| Error::config("weights", format!("there is no {name}")))
}

fn with_steps(config: TransitionConfig, steps: usize) -> TransitionConfig {
    TransitionConfig {
        sampler: Sampler {
            steps,
            ..config.sampler
        },
        ..config
    }
}
