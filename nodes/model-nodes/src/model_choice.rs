//! Which world model a node uses: the parameter `model`, and what of the model each node needs.

use anyhow::{Context as _, Result};
use wm_model::{Decoder, Encoder, actions::ActionEncoding};
use wm_zoo::{ModelFolder, success_probe::SuccessClassifier};

use crate::{history::Timing, predictor::PredictorModel};

/// The chosen model.
#[derive(Clone, Debug)]
pub struct ModelChoice {
    name: String,
}

impl ModelChoice {
    /// The model of this name: the embedded one's, or a folder of weights.
    pub fn new(name: String) -> Self {
        Self { name }
    }

    /// Opens the model, for as long as its parts are loaded.
    ///
    /// # Errors
    /// Names what is missing or wrong in it, or what does not fit together.
    pub fn open(&self) -> Result<OpenModel> {
        let text = format!("parameter model is \"{}\"", self.name);
        let model = ModelFolder::open(&self.name).with_context(|| text.clone())?;
        let name = self.name.clone();
        Ok(OpenModel { name, text, model })
    }
}

/// The model, open.
pub struct OpenModel {
    name: String,
    /// What errors begin with.
    text: String,
    model: ModelFolder,
}

impl OpenModel {
    /// What the parameter `model` says.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The encoder.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        self.model.encoder().with_context(|| self.text.clone())
    }

    /// The decoder, if the model has one.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn decoder(&self) -> Result<Option<Box<dyn Decoder>>> {
        self.model.decoder().with_context(|| self.text.clone())
    }

    /// The success probe and what reads instructions for it, if the model has one.
    ///
    /// # Errors
    /// Names what is missing or wrong in its files.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        self.model.probe().with_context(|| self.text.clone())
    }

    /// The transition model and the latent space that it works in.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn predictor(&self) -> Result<PredictorModel> {
        let bundled = self.model.transition().with_context(|| self.text.clone())?;
        Ok(PredictorModel {
            transition: bundled.model,
            name: self.name.clone(),
            hash: bundled.hash,
            space: bundled.space,
            encoding: bundled.encoding,
        })
    }
}

/// Timing of a camera with `frame_period` \[s\] between frames and of the model's steps.
pub fn timing(frame_period: f64, encoding: &ActionEncoding) -> Timing {
    // The parameter's descriptor keeps it within a minute.
    Timing::new((frame_period * 1e9).round() as i64, encoding.frame_skip())
}
