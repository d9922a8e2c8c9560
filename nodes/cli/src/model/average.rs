//! `wm model average`.

use std::path::PathBuf;

use crate::output::print;
use anyhow::{Context as _, Result, ensure};
use clap::Args;
use serde_json::Value;
use wm_model::{
    LatentSpace, Weights,
    trained_folder::{TRAINED_ON_KEY, TrainedFolder},
    transition::{ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, TransitionConfig},
    weights::{Precision, WeightsBuilder},
};

/// Averages the weights of a transition model and of one that was fine-tuned from it. The average keeps most of what the
/// fine-tuning taught, and regains most of what it made the model forget (Wortsman et al., "Robust fine-tuning of zero-shot
/// models", 2022).
#[derive(Args, Debug)]
pub(crate) struct AverageCommand {
    /// Model: tiny, or a model's folder
    #[arg(value_name = "MODEL")]
    first: String,
    /// The model that was fine-tuned from it, or the other way round
    #[arg(value_name = "TUNED")]
    second: String,
    /// File to write
    #[arg(short, long, value_name = "OUT.safetensors")]
    output: PathBuf,
    /// Share of the second model, 0 to 1
    #[arg(long, default_value_t = 0.5)]
    share: f32,
}

/// Sizes, latent space and actions: equal in a model and in those that were fine-tuned from it.
#[derive(Debug, PartialEq)]
struct Conventions {
    config: TransitionConfig,
    space: LatentSpace,
    actions: Value,
}

impl Conventions {
    fn of(weights: &Weights) -> Result<Self> {
        Ok(Self {
            config: weights.json(CONFIG_KEY)?,
            space: weights.json(LATENT_SPACE_KEY)?,
            actions: weights.json(ACTIONS_KEY)?,
        })
    }
}

impl AverageCommand {
    pub(crate) fn run(&self) -> Result<()> {
        ensure!(
            (0.0..=1.0).contains(&self.share),
            "--share is {}, expected 0 to 1",
            self.share
        );
        ensure!(
            !self.output.exists(),
            "{}: exists already; give another name or remove it",
            self.output.display()
        );
        let (first, second) = (weights(&self.first)?, weights(&self.second)?);
        let (ours, theirs) = (Conventions::of(&first)?, Conventions::of(&second)?);
        ensure!(
            ours == theirs,
            "{} and {} differ in sizes, latent space or actions: neither was fine-tuned from the other",
            self.first,
            self.second
        );
        let mut averaged = WeightsBuilder::new();
        for name in second.names() {
            let shape = second
                .shape(&name)
                .context("a tensor of the file")?
                .to_vec();
            let (a, b) = (first.values(&name, &shape)?, second.values(&name, &shape)?);
            let values: Vec<f32> = (a.iter().zip(&b))
                .map(|(a, b)| a * (1.0 - self.share) + b * self.share)
                .collect();
            averaged.values(&name, &shape, &values, Precision::F16);
        }
        for key in [CONFIG_KEY, LATENT_SPACE_KEY, ACTIONS_KEY, TRAINED_ON_KEY] {
            if let Some(value) = second.metadata(key) {
                averaged.metadata(key, value);
            }
        }
        averaged.write(&self.output)?;
        print(format_args!("wrote {}\n", self.output.display()))
    }
}

fn weights(model: &str) -> Result<Weights> {
    Ok(TrainedFolder::named(model).transition()?)
}

#[cfg(test)]
mod tests {
    use wm_model::trained_folder::TRANSITION_FILE;

    use super::*;

    fn command(second: &str, output: PathBuf, share: f32) -> AverageCommand {
        AverageCommand {
            first: "tiny".into(),
            second: second.into(),
            output,
            share,
        }
    }

    /// A folder with tiny's latents and its transition model, whose every weight is `more` greater.
    fn changed(folder: &std::path::Path, more: f32) -> String {
        let tiny = weights("tiny").unwrap();
        let mut copy = WeightsBuilder::new();
        for name in tiny.names() {
            let shape = tiny.shape(&name).unwrap().to_vec();
            let values = tiny.values(&name, &shape).unwrap();
            let values: Vec<f32> = values.iter().map(|value| value + more).collect();
            copy.values(&name, &shape, &values, Precision::F32);
        }
        for key in [CONFIG_KEY, LATENT_SPACE_KEY, ACTIONS_KEY] {
            copy.metadata(key, tiny.metadata(key).unwrap());
        }
        copy.write(folder.join(TRANSITION_FILE)).unwrap();
        folder.to_str().unwrap().to_owned()
    }

    #[test]
    fn weights_lie_between_those_of_the_models() {
        let dir = tempfile::tempdir().unwrap();
        let second = changed(dir.path(), 2.0);
        let out = dir.path().join("out.safetensors");
        command(&second, out.clone(), 0.25).run().unwrap();
        let (tiny, found) = (weights("tiny").unwrap(), Weights::open(&out).unwrap());
        for name in tiny.names() {
            let shape = tiny.shape(&name).unwrap().to_vec();
            let before = tiny.values(&name, &shape).unwrap();
            let after = found.values(&name, &shape).unwrap();
            let near = before
                .iter()
                .zip(&after)
                .all(|(a, b)| (b - a - 0.5).abs() < 2e-3 * (1.0 + a.abs()));
            assert!(near, "{name}");
        }
        assert_eq!(
            Conventions::of(&tiny).unwrap(),
            Conventions::of(&found).unwrap()
        );
        let error = command(&second, out, 0.5).run().unwrap_err().to_string();
        assert!(error.contains("exists already"), "{error}");
    }

    #[test]
    fn wrong_shares_and_other_models_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("out.safetensors");
        let error = command("tiny", out.clone(), 1.5)
            .run()
            .unwrap_err()
            .to_string();
        assert!(error.contains("--share is 1.5"), "{error}");
        let semantic = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../world-model/model/weights/semantic"
        );
        let error = command(semantic, out.clone(), 0.5)
            .run()
            .unwrap_err()
            .to_string();
        assert!(error.contains("differ in sizes"), "{error}");
        assert!(!out.exists());
    }
}
