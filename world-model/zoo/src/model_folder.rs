//! A world model on disk, by its name.

use std::collections::BTreeMap;
use std::path::Path;

use candle_core::Tensor;
use wm_model::trained_folder::{
    DISTANCE_FILE, EMBEDDED, IDM_FILE, PROBE_FILE, SUBGOALS_FILE, TRANSITION_FILE, TrainedFolder,
    transition_trained_on, weights_in,
};
use wm_model::transition::{
    ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition, TransitionConfig,
};
use wm_model::{
    Autoencoder, Compute, Decoder, Encoder, Fit, Framing, Kernels, LatentSpace, PictureSize,
    Weights, WorldModel,
};
use wm_motion::actions::ActionEncoding;

use crate::distance::TrainedDistance;
use crate::folder::{DescribedFolder, NativeDecoder, REQUIRED_FROM, open_own};
use crate::idm::TrainedIdm;
use crate::subgoals::TrainedSubgoals;
use crate::success_probe::SuccessClassifier;
use crate::{Error, Result, Unfinished};

/// The tensors and the configuration of a transition model.
#[derive(Clone, Debug)]
pub struct TransitionTensors {
    /// Sizes and conventions.
    pub config: TransitionConfig,
    /// How physical actions become its actions.
    pub encoding: ActionEncoding,
    /// All parameters by name.
    pub tensors: BTreeMap<String, Tensor>,
}

/// A world model by its name, as the parameter `model` of a node gives it: files whose names and shapes are checked, and
/// a [`Compute`] for its parts. Each part is loaded at its request; [`ModelFolder::world_model`] gives the [`WorldModel`].
///
/// Encoder, decoder and transition model take and give tensors of the CPU, on every device. The probe and the inverse
/// dynamics model are small: they compute on the CPU.
#[derive(Debug)]
pub struct ModelFolder {
    files: Files,
    compute: Compute,
}

#[derive(Debug)]
enum Files {
    /// The embedded default, or a folder whose encoder and decoder are an autoencoder.
    Trained(TrainedFolder),
    /// A folder of published networks.
    Described(Box<DescribedFolder>),
}

impl ModelFolder {
    /// Opens `tiny`, the embedded default, a folder, or the file of an autoencoder, to compute with the CPU's kernels.
    ///
    /// # Errors
    /// As [`Self::require`] and [`DescribedFolder::open`]; missing weights of an autoencoder's folder are an error of the
    /// part that needs them.
    pub fn open(name: &str) -> Result<Self> {
        Self::require(name)?;
        let path = Path::new(name);
        let files = if name == EMBEDDED || path.is_file() {
            Files::Trained(TrainedFolder::named(name))
        } else if !DescribedFolder::is_one(path) {
            tracing::warn!(
                "{name}: no model.json, which wm {REQUIRED_FROM} will need; `wm model convert {name}` writes it"
            );
            Files::Trained(TrainedFolder::named(name))
        } else {
            match open_own(path)? {
                Some(folder) => Files::Trained(folder),
                None => Files::Described(Box::new(DescribedFolder::open(name)?)),
            }
        };
        Ok(Self {
            files,
            compute: Compute::default(),
        })
    }

    /// The same, to compute on the device and with the kernels of `compute`; a folder with a `model.json` has a number
    /// format of its own. Each part opens the device apart, so that parts in several threads do not wait for each other.
    #[must_use]
    pub fn on(self, compute: Compute) -> Self {
        Self { compute, ..self }
    }

    /// The folder of published networks; `None` for another model.
    pub fn described(&self) -> Option<&DescribedFolder> {
        match &self.files {
            Files::Trained(_) => None,
            Files::Described(folder) => Some(folder),
        }
    }

    /// The same, to keep.
    pub fn into_described(self) -> Option<DescribedFolder> {
        match self.files {
            Files::Trained(_) => None,
            Files::Described(folder) => Some(*folder),
        }
    }

    /// The embedded default, or a folder whose encoder and decoder are an autoencoder; `None` for another model.
    pub fn trained(&self) -> Option<&TrainedFolder> {
        match &self.files {
            Files::Trained(folder) => Some(folder),
            Files::Described(_) => None,
        }
    }

    /// Checks that a name is that of a model, without opening a file.
    ///
    /// # Errors
    /// [`Error::NoModel`] for a path that does not exist, and for a folder without a `model.json` and weights.
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

    /// The name by which it was opened.
    pub fn name(&self) -> String {
        match &self.files {
            Files::Trained(folder) => folder.name(),
            Files::Described(folder) => folder.name().to_owned(),
        }
    }

    /// The space of its latents.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn space(&self) -> Result<LatentSpace> {
        match &self.files {
            Files::Trained(folder) => Ok(folder.autoencoder()?.space().clone()),
            Files::Described(folder) => folder.space(),
        }
    }

    /// How its encoder takes pictures of another aspect, without loading the encoder of a described folder.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn fit(&self) -> Result<Fit> {
        match &self.files {
            Files::Trained(folder) => Ok(folder.autoencoder()?.config().fit),
            Files::Described(folder) => Ok(folder.description().fit),
        }
    }

    /// How pictures become those of its encoder, with the number of cameras side by side in its training; without loading
    /// the encoder of a described folder. An autoencoder takes any number, so that of the transition model counts.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn framing(&self) -> Result<Framing> {
        match &self.files {
            Files::Trained(folder) => {
                let framing = folder.autoencoder()?.config().framing();
                let views = match folder.has_transition() {
                    true => {
                        let config: TransitionConfig = folder.transition()?.json(CONFIG_KEY)?;
                        config.views
                    }
                    false => framing.views,
                };
                Ok(Framing { views, ..framing })
            }
            Files::Described(folder) => Ok(folder.framing()),
        }
    }

    /// Size of the camera's pictures that it was trained on: those of the transition model, or else of the encoder; `None`
    /// if it is not known.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn trained_on(&self) -> Result<Option<PictureSize>> {
        match &self.files {
            Files::Trained(folder) => Ok(folder.trained_on()?),
            Files::Described(folder) => {
                let transition = weights_in(Path::new(folder.name()), TRANSITION_FILE)?;
                let own = transition_trained_on(transition.as_ref())?;
                Ok(own.or(folder.description().trained_on))
            }
        }
    }

    /// The space of its latents for what was trained on `trained_on`, perhaps in another number format.
    fn space_of_training(&self, trained_on: &LatentSpace) -> Result<LatentSpace> {
        match &self.files {
            Files::Trained(_) => self.space(),
            Files::Described(folder) => folder.space_of_training(trained_on),
        }
    }

    /// Loads the encoder.
    ///
    /// # Errors
    /// Names missing and wrong weights; or the device cannot be used or has no memory for it.
    pub fn encoder(&self) -> Result<Box<dyn Encoder>> {
        let compute = self.compute.apart();
        match &self.files {
            Files::Trained(folder) => match compute.kernels() {
                Kernels::Cpu => Ok(Box::new(folder.autoencoder()?)),
                Kernels::Candle => Ok(Box::new(on_tensors(folder, &compute)?)),
            },
            Files::Described(folder) => folder.encoder(&compute),
        }
    }

    /// Loads the decoder; `None` if the model has none.
    ///
    /// # Errors
    /// Names missing and wrong weights; or the device cannot be used or has no memory for it.
    pub fn decoder(&self) -> Result<Option<Box<dyn Decoder>>> {
        let compute = self.compute.apart();
        match &self.files {
            Files::Trained(folder) => match compute.kernels() {
                Kernels::Cpu => Ok(Some(Box::new(folder.autoencoder()?))),
                Kernels::Candle => Ok(Some(Box::new(on_tensors(folder, &compute)?))),
            },
            Files::Described(folder) => folder.decoder(&compute),
        }
    }

    /// Whether there is a transition model; without one a model encodes and decodes only.
    pub fn has_transition(&self) -> bool {
        match &self.files {
            Files::Trained(folder) => folder.has_transition(),
            Files::Described(folder) => folder.has_transition(),
        }
    }

    /// Refuses a model without a transition model. Reads no weights.
    ///
    /// # Errors
    /// [`Error::NoTransition`], with the command that adds one.
    pub fn require_transition(&self) -> Result<()> {
        match self.has_transition() {
            true => Ok(()),
            false => Err(Error::NoTransition { name: self.name() }),
        }
    }

    /// The parts whose training is unfinished.
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

    /// How physical actions become the transition model's, read without loading it; `None` if there is no transition model.
    ///
    /// # Errors
    /// When its file is missing or corrupt.
    pub fn action_encoding(&self) -> Result<Option<ActionEncoding>> {
        match &self.files {
            Files::Trained(folder) if folder.has_transition() => {
                Ok(Some(folder.transition()?.json(ACTIONS_KEY)?))
            }
            Files::Trained(_) => Ok(None),
            Files::Described(folder) => Ok(folder.action_encoding().cloned()),
        }
    }

    /// Loads the transition model with its latent space and its actions.
    ///
    /// # Errors
    /// [`Error::NoTransition`]; names missing and wrong weights; or the device cannot be used or has no memory for it.
    pub fn world_model(&self) -> Result<WorldModel> {
        self.require_transition()?;
        match &self.files {
            Files::Trained(folder) => Ok(folder.world_model(&self.compute.apart())?),
            Files::Described(folder) => folder.world_model(&self.compute.apart()),
        }
    }

    /// The tensors of the transition model, by their published names: the start of a fine-tuning.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn transition_tensors(&self) -> Result<TransitionTensors> {
        match &self.files {
            Files::Trained(folder) => {
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
            Files::Described(folder) => folder.transition_tensors(),
        }
    }

    /// Loads the success probe and the reader of its instructions; `None` if the model has none.
    ///
    /// # Errors
    /// If a file of it is missing or invalid.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        if let Files::Described(folder) = &self.files
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

    /// Loads the decoder of its adapter; `None` if its latents are the encoder's own.
    ///
    /// # Errors
    /// Names missing and wrong weights.
    pub fn native_decoder(&self) -> Result<Option<NativeDecoder>> {
        match &self.files {
            Files::Trained(_) => Ok(None),
            Files::Described(folder) => folder.native_decoder(),
        }
    }

    /// Loads the inverse dynamics model; `None` if the model has none.
    ///
    /// # Errors
    /// If its file is invalid, or it was trained on another latent space.
    pub fn idm(&self) -> Result<Option<TrainedIdm>> {
        let Some(weights) = self.weights(IDM_FILE)? else {
            return Ok(None);
        };
        let idm = TrainedIdm::from_weights(weights)?;
        idm.space().require(&self.space_of_training(idm.space())?)?;
        Ok(Some(idm))
    }

    /// Loads the model of subgoals; `None` if the model has none.
    ///
    /// # Errors
    /// If its file is invalid, or it was trained on another latent space.
    pub fn subgoals(&self) -> Result<Option<TrainedSubgoals>> {
        let Some(weights) = self.weights(SUBGOALS_FILE)? else {
            return Ok(None);
        };
        let subgoals = TrainedSubgoals::from_weights(weights)?;
        let own = self.space_of_training(subgoals.space())?;
        subgoals.space().require(&own)?;
        Ok(Some(subgoals))
    }

    /// Loads the learnt distance; `None` if the model has none.
    ///
    /// # Errors
    /// If its file is invalid, or it was trained on another latent space.
    pub fn distance(&self) -> Result<Option<TrainedDistance>> {
        let Some(weights) = self.weights(DISTANCE_FILE)? else {
            return Ok(None);
        };
        let distance = TrainedDistance::from_weights(weights)?;
        let own = self.space_of_training(distance.space())?;
        distance.space().require(&own)?;
        Ok(Some(distance))
    }

    /// A file of a training in the folder, as [`IDM_FILE`]; `None` if it does not exist.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn weights(&self, file: &str) -> Result<Option<Weights>> {
        Ok(match &self.files {
            Files::Trained(folder) => folder.weights(file)?,
            Files::Described(folder) => weights_in(Path::new(folder.name()), file)?,
        })
    }
}

/// Whether a folder has weights of a training. A folder that cannot be listed counts too: opening it gives the reason.
fn has_weights(folder: &Path) -> bool {
    let is_weights = |file: &Path| file.extension().is_some_and(|is| is == "safetensors");
    std::fs::read_dir(folder).map_or(true, |mut entries| {
        entries.any(|entry| entry.is_ok_and(|entry| is_weights(&entry.path())))
    })
}

fn on_tensors(folder: &TrainedFolder, compute: &Compute) -> Result<Autoencoder> {
    Ok(folder.autoencoder()?.on_tensors(compute.device()?)?)
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
