//! Which world model a node uses: the parameter `model`, and what of the model each node needs.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use wm_model::{Autoencoder, Decoder, Encoder, Weights, actions::ActionEncoding, transition::Transition};
use wm_ros::{Descriptor, Node};

use crate::{predictor::PredictorModel, timeline::Timing};

/// The chosen model.
#[derive(Clone, Debug)]
pub struct ModelChoice {
    name: String,
    folder: PathBuf,
}

/// Declares the parameter `model` and reads it.
///
/// # Errors
/// The parameter is of another type.
pub fn declare(node: &Node) -> Result<ModelChoice> {
    let descriptor = Descriptor::new("world model: tiny (bundled), or a folder of weights").read_only();
    let name = node.declare("model", "tiny".to_owned(), descriptor)?.get();
    if name == "tiny" {
        bail!("no bundled model yet");
    }
    Ok(ModelChoice { folder: PathBuf::from(&name), name })
}

/// The encoder.
///
/// # Errors
/// Names what is missing or wrong in the weights.
pub fn encoder(choice: &ModelChoice) -> Result<Box<dyn Encoder>> {
    Ok(Box::new(autoencoder(choice)?))
}

/// The decoder.
///
/// # Errors
/// Names what is missing or wrong in the weights.
pub fn decoder(choice: &ModelChoice) -> Result<Box<dyn Decoder>> {
    Ok(Box::new(autoencoder(choice)?))
}

/// The transition model and the latent space that it works in.
///
/// # Errors
/// Names what is missing or wrong in the weights.
pub fn predictor(choice: &ModelChoice) -> Result<PredictorModel> {
    let space = autoencoder(choice)?.space().clone();
    let weights = Weights::open(choice.folder.join("transition.safetensors"))?;
    let hash = weights.sha256();
    let transition = Transition::from_weights(weights).with_context(|| format!("model {}", choice.name))?;
    let config = transition.config();
    let encoding = ActionEncoding {
        action_dim: config.action_dim,
        frame_skip: config.frame_skip,
        ..ActionEncoding::default()
    };
    Ok(PredictorModel { name: choice.name.clone(), hash, space, encoding, transition })
}

/// Timing of a camera with `frame_period` \[s\] between frames and of the model's steps.
pub fn timing(frame_period: f64, encoding: &ActionEncoding) -> Timing {
    // The parameter's descriptor keeps it within a minute.
    Timing::new((frame_period * 1e9).round() as i64, encoding.frame_skip)
}

fn autoencoder(choice: &ModelChoice) -> Result<Autoencoder> {
    Autoencoder::open(choice.folder.join("autoencoder.safetensors")).with_context(|| format!("model {}", choice.name))
}
