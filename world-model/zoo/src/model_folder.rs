//! A world model on disk, by its name.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Tensor;
use wm_model::trained_folder::{EMBEDDED, IDM_FILE, PROBE_FILE, TrainedFolder};
use wm_model::transition::{
    ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition, TransitionConfig,
};
use wm_model::{
    Autoencoder, Decoder, Encoder, Fit, LatentSpace, PictureSize, Place, Weights, WorldModel,
};
use wm_motion::actions::ActionEncoding;

use crate::folder::{DescribedFolder, NativeDecoder};
use crate::idm::TrainedIdm;
use crate::success_probe::SuccessClassifier;
use crate::{Engine, Error, Result, Unfinished};

/// The tensors of a transition model, and what it is.
#[derive(Clone, Debug)]
pub struct TransitionTensors {
    /// Sizes and conventions.
    pub config: TransitionConfig,
    /// What its actions are.
    pub encoding: ActionEncoding,
    /// All parameters by name.
    pub tensors: BTreeMap<String, Tensor>,
}

/// What a node's parameter `model` names: the files of a world model, checked as far as names and shapes go. Its parts are
/// loaded when they are asked for; [`ModelFolder::world_model`] gives the [`WorldModel`].
#[derive(Debug)]
pub enum ModelFolder {
    /// The embedded default, or a folder that the training wrote.
    Trained(TrainedFolder),
    /// A folder of published checkpoints with a `model.json`.
    Described(Box<DescribedFolder>),
}

impl ModelFolder {
    /// Opens `tiny`, the embedded default, a folder, or the file of an autoencoder.
    ///
    /// # Errors
    /// As [`Self::require`] and [`DescribedFolder::open`]; a folder without `model.json` tells of what is missing when a
    /// part is asked for.
    pub fn open(name: &str) -> Result<Self> {
        Self::require(name)?;
        if name != EMBEDDED && DescribedFolder::is_one(Path::new(name)) {
            return Ok(Self::Described(Box::new(DescribedFolder::open(name)?)));
        }
        Ok(Self::Trained(TrainedFolder::named(name)))
    }

    /// Holds a name against what is on the disk, without opening a file.
    ///
    /// # Errors
    /// [`Error::NoModel`] for a path where there is nothing, and a folder without a `model.json` or any weights.
    pub fn require(name: &str) -> Result<()> {
        let path = Path::new(name);
        let found = if name == EMBEDDED || path.is_file() || DescribedFolder::is_one(path) {
            return Ok(());
        } else if !path.is_dir() {
            "no such folder"
        } else if has_weights(path) {
            return Ok(());
        } else {
            "there is no model.json and no .safetensors file in it"
        };
        let name = name.to_owned();
        Err(Error::NoModel { name, found })
    }

    /// What it was opened by.
    pub fn name(&self) -> String {
        match self {
            Self::Trained(folder) => folder.name(),
            Self::Described(folder) => folder.name().to_owned(),
        }
    }

    /// The space of its latents.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn space(&self) -> Result<LatentSpace> {
        match self {
            Self::Trained(folder) => Ok(folder.autoencoder()?.space().clone()),
            Self::Described(folder) => folder.space(),
        }
    }

    /// How its encoder takes pictures of another aspect, without loading the encoder of a described folder.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn fit(&self) -> Result<Fit> {
        match self {
            Self::Trained(folder) => Ok(folder.autoencoder()?.config().fit),
            Self::Described(folder) => Ok(folder.description().fit),
        }
    }

    /// Size of the camera's pictures that it was trained on: those of the transition model, or else of the encoder; `None`
    /// if it is not known.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn trained_on(&self) -> Result<Option<PictureSize>> {
        match self {
            Self::Trained(folder) => Ok(folder.trained_on()?),
            Self::Described(folder) => {
                let trained = TrainedFolder::Folder(folder.name().into());
                let own = trained.transition_trained_on()?;
                Ok(own.or(folder.description().trained_on))
            }
        }
    }

    /// The space of its latents for what was trained on `trained_on`, perhaps in another number format.
    fn space_of_training(&self, trained_on: &LatentSpace) -> Result<LatentSpace> {
        match self {
            Self::Trained(_) => self.space(),
            Self::Described(folder) => folder.space_of_training(trained_on),
        }
    }

    /// Loads the encoder.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        self.encoder_on(&Place::default())
    }

    /// As [`Self::encoder`], to compute at `place`.
    ///
    /// # Errors
    /// As [`Self::encoder`]; or that the device has no memory for it.
    pub fn encoder_on(&self, place: &Place) -> Result<Box<dyn Encoder>> {
        match self {
            Self::Trained(folder) => match place.engine() {
                Engine::Cpu => Ok(Box::new(folder.autoencoder()?)),
                Engine::Candle => Ok(Box::new(on_tensors(folder, place)?)),
            },
            Self::Described(folder) => folder.encoder_on(place),
        }
    }

    /// Loads the decoder; `None` where the model has none.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn decoder(&self) -> Result<Option<Box<dyn Decoder>>> {
        self.decoder_on(&Place::default())
    }

    /// As [`Self::decoder`], to compute at `place`.
    ///
    /// # Errors
    /// As [`Self::decoder`]; or that the device has no memory for it.
    pub fn decoder_on(&self, place: &Place) -> Result<Option<Box<dyn Decoder>>> {
        match self {
            Self::Trained(folder) => match place.engine() {
                Engine::Cpu => Ok(Some(Box::new(folder.autoencoder()?))),
                Engine::Candle => Ok(Some(Box::new(on_tensors(folder, place)?))),
            },
            Self::Described(folder) => folder.decoder_on(place),
        }
    }

    /// Whether there is a transition model; without one a model encodes and decodes only.
    pub fn has_transition(&self) -> bool {
        match self {
            Self::Trained(folder) => folder.has_transition(),
            Self::Described(folder) => folder.has_transition(),
        }
    }

    /// Refuses a model that cannot predict, for those who need one that can. Reads no weights.
    ///
    /// # Errors
    /// [`Error::NoTransition`], which says what to do about it.
    pub fn require_transition(&self) -> Result<()> {
        match self.has_transition() {
            true => Ok(()),
            false => Err(Error::NoTransition { name: self.name() }),
        }
    }

    /// The parts whose training has not taken its last step.
    ///
    /// # Errors
    /// If a mark cannot be read.
    pub fn unfinished(&self) -> Result<Vec<Unfinished>> {
        let name = self.name();
        let path = Path::new(&name);
        match name == EMBEDDED || path.is_file() {
            true => Ok(Vec::new()),
            false => Unfinished::all(path),
        }
    }

    /// How the transition model takes actions, read without loading the model; `None` if there is no transition model.
    ///
    /// # Errors
    /// When its file is missing or corrupt.
    pub fn action_encoding(&self) -> Result<Option<ActionEncoding>> {
        match self {
            Self::Trained(folder) if folder.has_transition() => {
                Ok(Some(folder.transition()?.json(ACTIONS_KEY)?))
            }
            Self::Trained(_) => Ok(None),
            Self::Described(folder) => Ok(folder.action_encoding().cloned()),
        }
    }

    /// Loads the transition model with what is needed to use it.
    ///
    /// # Errors
    /// [`Error::NoTransition`], or what is missing or wrong in the weights.
    pub fn world_model(&self) -> Result<WorldModel> {
        self.world_model_on(&Place::default())
    }

    /// As [`Self::world_model`], to compute at `place`.
    ///
    /// # Errors
    /// As [`Self::world_model`]; or that the device has no memory for it.
    pub fn world_model_on(&self, place: &Place) -> Result<WorldModel> {
        self.require_transition()?;
        match self {
            Self::Trained(folder) => Ok(folder.world_model_on(place)?),
            Self::Described(folder) => folder.world_model_on(place),
        }
    }

    /// The tensors of the transition model, by their published names: what a training begins from.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn transition_tensors(&self) -> Result<TransitionTensors> {
        match self {
            Self::Trained(folder) => {
                let weights = folder.transition()?;
                let config: TransitionConfig = weights.json(CONFIG_KEY)?;
                let mut tensors = BTreeMap::new();
                Transition::build(config.clone(), &mut |parameter| {
                    let tensor = weights.tensor(&parameter.name, &parameter.shape)?;
                    tensors.insert(parameter.name.clone(), tensor.clone());
                    Ok(tensor)
                })?;
                let encoding = weights.json(ACTIONS_KEY)?;
                weights.finish()?;
                Ok(TransitionTensors {
                    config,
                    encoding,
                    tensors,
                })
            }
            Self::Described(folder) => folder.transition_tensors(),
        }
    }

    /// Loads the success probe and what reads instructions for it; `None` where the model has none.
    ///
    /// # Errors
    /// Names what is missing or wrong in its files.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        if let Self::Described(folder) = self
            && let Some(probe) = folder.probe()?
        {
            return Ok(Some(probe));
        }
        match self.weights(PROBE_FILE)? {
            Some(weights) => {
                let trained_on: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
                let space = self.space_of_training(&trained_on)?;
                SuccessClassifier::of_trained(weights, &space).map(Some)
            }
            None => Ok(None),
        }
    }

    /// Loads the decoder of its adapter; `None` where its latents are the encoder's own.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn native_decoder(&self) -> Result<Option<NativeDecoder>> {
        match self {
            Self::Trained(_) => Ok(None),
            Self::Described(folder) => folder.native_decoder(),
        }
    }

    /// Loads the inverse dynamics model; `None` where the model has none.
    ///
    /// # Errors
    /// Names what is missing or wrong in its file, or the space that it was trained on.
    pub fn idm(&self) -> Result<Option<TrainedIdm>> {
        let Some(weights) = self.weights(IDM_FILE)? else {
            return Ok(None);
        };
        let idm = TrainedIdm::from_weights(weights)?;
        idm.space().require(&self.space_of_training(idm.space())?)?;
        Ok(Some(idm))
    }

    /// A file of the training's in it, as [`IDM_FILE`]; `None` where there is none.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn weights(&self, file: &str) -> Result<Option<Weights>> {
        Ok(match self {
            Self::Trained(folder) => folder.weights(file)?,
            Self::Described(folder) => TrainedFolder::Folder(folder.name().into()).weights(file)?,
        })
    }
}

/// Whether the training may have written a part of a model there. A folder that cannot be listed is taken for one, so
/// that opening it says why.
fn has_weights(folder: &Path) -> bool {
    let is_weights = |file: &Path| file.extension().is_some_and(|is| is == "safetensors");
    std::fs::read_dir(folder).map_or(true, |mut entries| {
        entries.any(|entry| entry.is_ok_and(|entry| is_weights(&entry.path())))
    })
}

fn on_tensors(folder: &TrainedFolder, place: &Place) -> Result<Autoencoder> {
    Ok(folder.autoencoder()?.on_tensors(place.device())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_model_is_named_before_a_file_is_opened() {
        let scratch = tempfile::tempdir().unwrap();
        let at = |name: &str| scratch.path().join(name).display().to_string();
        let refused = |name: &str| ModelFolder::open(name).unwrap_err().to_string();
        let error = refused(&at("absent"));
        assert!(
            error.starts_with(&format!(
                "{}: no such folder; a model is `tiny`",
                at("absent")
            )),
            "{error}"
        );
        std::fs::create_dir(at("bag")).unwrap();
        std::fs::write(at("bag/metadata.yaml"), "").unwrap();
        let error = refused(&at("bag"));
        assert!(
            error.contains("no model.json and no .safetensors"),
            "{error}"
        );
        // A part alone is something to train beside, or to begin from.
        std::fs::write(at("bag/idm.safetensors"), "").unwrap();
        ModelFolder::require(&at("bag")).unwrap();
        ModelFolder::require(&at("bag/idm.safetensors")).unwrap();
        ModelFolder::require(EMBEDDED).unwrap();
    }
    #[test]
    fn an_autoencoder_alone_is_refused_with_what_to_do() {
        let scratch = tempfile::tempdir().unwrap();
        let name = scratch.path().display().to_string();
        let tiny = TrainedFolder::Embedded.autoencoder().unwrap();
        let file = scratch.path().join("autoencoder.safetensors");
        tiny.save(file, wm_model::weights::Precision::F16).unwrap();
        let model = ModelFolder::open(&name).unwrap();
        model.encoder().unwrap();
        for error in [
            model.require_transition().unwrap_err(),
            model.world_model().unwrap_err(),
        ] {
            assert!(matches!(error, Error::NoTransition { .. }), "{error}");
            let way = format!("wm train transition --data BAGS --encoder {name} --out {name}");
            assert!(error.to_string().contains(&way), "{error}");
        }
        ModelFolder::open(EMBEDDED)
            .unwrap()
            .require_transition()
            .unwrap();
    }
}
