//! A world model, and where its parts compute.

use wm_model::{Decoder, Encoder, Fit, PictureSize, WorldModel};
use wm_motion::actions::ActionEncoding;

use crate::idm::TrainedIdm;
use crate::success_probe::SuccessClassifier;
use crate::{ModelFolder, Placement, Result};

/// The files of a world model, and what is to compute its parts: what a node is given. Encoder, decoder and transition
/// model take and give tensors of the CPU wherever they compute. The small networks beside them, the probe and the inverse
/// dynamics model, compute on the CPU.
#[derive(Debug)]
pub struct PlacedModel {
    folder: ModelFolder,
    placement: Placement,
}

impl PlacedModel {
    /// The model of `folder`.
    pub fn new(folder: ModelFolder, placement: Placement) -> Self {
        Self { folder, placement }
    }

    /// What the folder was opened by.
    pub fn name(&self) -> String {
        self.folder.name()
    }

    /// As [`ModelFolder::action_encoding`].
    ///
    /// # Errors
    /// As there.
    pub fn action_encoding(&self) -> Result<Option<ActionEncoding>> {
        self.folder.action_encoding()
    }

    /// As [`ModelFolder::fit`].
    ///
    /// # Errors
    /// As there.
    pub fn fit(&self) -> Result<Fit> {
        self.folder.fit()
    }

    /// As [`ModelFolder::trained_on`].
    ///
    /// # Errors
    /// As there.
    pub fn trained_on(&self) -> Result<Option<PictureSize>> {
        self.folder.trained_on()
    }

    /// As [`ModelFolder::encoder`].
    ///
    /// # Errors
    /// As there; or that the device cannot be used.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        self.folder.encoder_on(&self.placement.open()?)
    }

    /// As [`ModelFolder::decoder`].
    ///
    /// # Errors
    /// As there; or that the device cannot be used.
    pub fn decoder(&self) -> Result<Option<Box<dyn Decoder>>> {
        self.folder.decoder_on(&self.placement.open()?)
    }

    /// As [`ModelFolder::world_model`].
    ///
    /// # Errors
    /// As there; or that the device cannot be used.
    pub fn world_model(&self) -> Result<WorldModel> {
        self.folder.world_model_on(&self.placement.open()?)
    }

    /// As [`ModelFolder::probe`].
    ///
    /// # Errors
    /// As there.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        self.folder.probe()
    }

    /// As [`ModelFolder::idm`].
    ///
    /// # Errors
    /// As there.
    pub fn idm(&self) -> Result<Option<TrainedIdm>> {
        self.folder.idm()
    }
}

impl From<ModelFolder> for PlacedModel {
    /// On the CPU.
    fn from(folder: ModelFolder) -> Self {
        Self::new(folder, Placement::default())
    }
}
