//! Which world model a node uses: the parameter `model`, and what of the model each node needs.

use anyhow::{Context as _, Result};
use wm_model::{
    Decoder, Encoder,
    actions::ActionEncoding,
    bundle::{Bundle, EMBEDDED},
};
use wm_ros::{Descriptor, Node};

use crate::{predictor::PredictorModel, timeline::Timing};

/// The chosen model.
#[derive(Clone, Debug)]
pub struct ModelChoice {
    name: String,
    bundle: Bundle,
}

/// Declares the parameter `model` and reads it.
///
/// # Errors
/// The parameter is of another type.
pub fn declare(node: &Node) -> Result<ModelChoice> {
    let text = format!("world model: {EMBEDDED} (embedded), or a folder of weights");
    let name = node
        .declare(
            "model",
            EMBEDDED.to_owned(),
            Descriptor::new(text).read_only(),
        )?
        .get();
    Ok(ModelChoice {
        bundle: Bundle::named(&name),
        name,
    })
}

impl ModelChoice {
    /// The encoder.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        Ok(Box::new(
            self.bundle.autoencoder().with_context(|| self.text())?,
        ))
    }

    /// The decoder.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn decoder(&self) -> Result<Box<dyn Decoder>> {
        Ok(Box::new(
            self.bundle.autoencoder().with_context(|| self.text())?,
        ))
    }

    /// The transition model and the latent space that it works in.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn predictor(&self) -> Result<PredictorModel> {
        let bundled = self.bundle.transition().with_context(|| self.text())?;
        bundled.encoding.validate().with_context(|| self.text())?;
        Ok(PredictorModel {
            transition: bundled.model,
            name: self.name.clone(),
            hash: bundled.hash,
            space: bundled.space,
            encoding: bundled.encoding,
        })
    }

    fn text(&self) -> String {
        format!("parameter model is \"{}\"", self.name)
    }
}

/// Timing of a camera with `frame_period` \[s\] between frames and of the model's steps.
pub fn timing(frame_period: f64, encoding: &ActionEncoding) -> Timing {
    // The parameter's descriptor keeps it within a minute.
    Timing::new((frame_period * 1e9).round() as i64, encoding.frame_skip)
}
