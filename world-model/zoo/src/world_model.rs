//! A whole world model, wherever it comes from.

use std::path::Path;

use wm_model::bundle::{Bundle, BundledTransition, EMBEDDED};
use wm_model::{Decoder, Encoder};

use crate::success_probe::SuccessClassifier;
use crate::{ModelFolder, Result};

/// A world model by its name: what a node's parameter `model` says.
#[derive(Debug)]
pub enum WorldModel {
    /// The embedded default, or a folder that the training wrote.
    Bundle(Bundle),
    /// A folder with a `model.json`.
    Folder(Box<ModelFolder>),
}

impl WorldModel {
    /// Opens `tiny`, the embedded default, or a folder.
    ///
    /// # Errors
    /// As [`ModelFolder::open`]; a folder without `model.json` tells of what is missing when a part is asked for.
    pub fn open(name: &str) -> Result<Self> {
        if name != EMBEDDED && ModelFolder::is_one(Path::new(name)) {
            return Ok(Self::Folder(Box::new(ModelFolder::open(name)?)));
        }
        Ok(Self::Bundle(Bundle::named(name)))
    }

    /// Loads the encoder.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        match self {
            Self::Bundle(bundle) => Ok(Box::new(bundle.autoencoder()?)),
            Self::Folder(folder) => folder.encoder(),
        }
    }

    /// Loads the decoder; `None` where the model has none.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn decoder(&self) -> Result<Option<Box<dyn Decoder>>> {
        match self {
            Self::Bundle(bundle) => Ok(Some(Box::new(bundle.autoencoder()?))),
            Self::Folder(folder) => folder.decoder(),
        }
    }

    /// Loads the transition model.
    ///
    /// # Errors
    /// Names what is missing or wrong in the weights.
    pub fn transition(&self) -> Result<BundledTransition> {
        match self {
            Self::Bundle(bundle) => Ok(bundle.transition()?),
            Self::Folder(folder) => folder.transition(),
        }
    }

    /// Loads the success probe and what reads instructions for it; `None` where the model has none.
    ///
    /// # Errors
    /// Names what is missing or wrong in its files.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        match self {
            Self::Bundle(_) => Ok(None),
            Self::Folder(folder) => folder.probe(),
        }
    }
}
