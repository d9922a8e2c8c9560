//! Worker processes of a training.

use std::{path::PathBuf, time::Duration};

use anyhow::{Context as _, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use wm_dataset::{Data, Dataset, Latents};
use wm_model::{NumberFormat, transition::TransitionConfig};
use wm_motion::actions::ActionEncoding;
use wm_zoo::ModelFolder;

use super::{TrainWorkerArgs, TransitionRecipe, TransitionTask};
use crate::{
    arguments::RunArgs,
    fresh_weights::FreshWeights,
    network_variables::Share,
    processes::{Coordinator, Limits, Offer, Worker},
    run::{RunEnd, Stop},
};

/// The computation of a worker, which has the data; each step brings the weights.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Setup {
    recipe: TransitionRecipe,
    encoding: ActionEncoding,
    config: TransitionConfig,
    dtype: NumberFormat,
}

impl Setup {
    pub(super) fn new(
        recipe: &TransitionRecipe,
        encoding: &ActionEncoding,
        config: &TransitionConfig,
        run: &RunArgs,
    ) -> Self {
        Self {
            recipe: recipe.clone(),
            encoding: encoding.clone(),
            config: config.clone(),
            dtype: run.dtype,
        }
    }

    /// Listens for workers with the data `train`; `processes` are the own threads, and the workers to wait for.
    pub(super) fn listen(
        &self,
        address: &str,
        train: &Latents,
        processes: (usize, usize),
    ) -> Result<Coordinator> {
        let offer = Offer {
            version: version(),
            data: description(train),
            setup: serde_yaml_ng::to_string(self)?,
        };
        let coordinator = Coordinator::listen(address, offer, processes, Limits::default())?;
        println!(
            "listening for workers on {}, without authentication or encryption: wm train worker HOST:{} --data DATA \
             --encoder ENCODER",
            coordinator.address(),
            coordinator.address().port()
        );
        Ok(coordinator)
    }
}

impl TrainWorkerArgs {
    /// Computes for the training until its end, or until `stop` is set.
    ///
    /// # Errors
    /// If the data cannot be read, the training refuses this process, ends with an error or stays unreachable.
    pub fn run(&self, stop: &Stop) -> Result<RunEnd> {
        let folder = ModelFolder::open(&self.encoder)?;
        let encoder = folder.encoder()?;
        let run = self.of_run();
        let cache = run.cache();
        let data = Data::open(&self.data, encoder.framing(), &cache, &self.options)?;
        let train = Latents::open(&data.training, &*encoder, &cache)?;
        let wait = Duration::from_secs(self.wait);
        work_on(
            &run,
            (&train, Some(&data.training)),
            (&self.address, wait),
            stop,
        )
    }

    fn of_run(&self) -> RunArgs {
        RunArgs {
            data: self.data.clone(),
            options: self.options.clone(),
            // Only a training writes there.
            out: PathBuf::new(),
            cache: Some(self.cache.clone().unwrap_or_else(std::env::temp_dir)),
            recipe: String::new(),
            set: Vec::new(),
            steps: None,
            share: 1.0,
            from: None,
            old_rate: 1.0,
            threads: self.threads,
            device: self.device.clone(),
            dtype: NumberFormat::F32,
        }
    }
}

/// Computes for the training at `address`, which may be unreachable for `wait`.
pub(super) fn work_on(
    run: &RunArgs,
    train: (&Latents, Option<&Dataset>),
    (address, wait): (&str, Duration),
    stop: &Stop,
) -> Result<RunEnd> {
    let worker = Worker {
        address: address.to_owned(),
        version: version(),
        threads: run.threads()?,
        data: description(train.0),
        wait,
    };
    while let Some(accepted) = worker.join(stop)? {
        let setup = serde_yaml_ng::from_str(&accepted.setup);
        let setup: Setup = setup.context("the description of the training")?;
        let task = task(&setup, run, train).map_err(|error| accepted.failed(error))?;
        if let Some(ended) = accepted.work(&mut Share(task), stop)? {
            return Ok(ended);
        }
    }
    Ok(RunEnd::Stopped)
}

fn task<'a>(
    setup: &'a Setup,
    run: &RunArgs,
    train: (&'a Latents, Option<&'a Dataset>),
) -> Result<TransitionTask<'a>> {
    let Setup {
        recipe,
        encoding,
        config,
        dtype,
    } = setup;
    config.validate()?;
    let run = RunArgs {
        dtype: *dtype,
        ..run.clone()
    };
    let fresh = FreshWeights::new(recipe.seed).on(&run.compute()?)?;
    TransitionTask::new(recipe, (encoding, config.clone()), fresh, train, None, &run)
}

fn version() -> String {
    env!("CARGO_PKG_VERSION").to_owned()
}

/// The properties of data that training and worker have in common.
fn description(train: &Latents) -> Value {
    json!({
        "data": train.digest(),
        "latent_space": train.space().to_string(),
        "actions": train.action_space(),
        "views": train.views(),
    })
}
