//! A world model as a folder: its `model.json` names the parts, their configurations and their files.
//!
//! ```json
//! {
//!   "name": "web-dino-96",
//!   "encoder": {"kind": "web-dino", "config": "web-dino/config.json", "weights": "web-dino/model.safetensors"},
//!   "adapter": {"kind": "svae", "weights": "svae.pt",
//!               "config": {"features": 1024, "latent": 96, "heads": 16, "layers": 3, "ffn": 1024}},
//!   "normalisation": "stats.safetensors",
//!   "decoder": {"kind": "pixel", "weights": "svae.pt",
//!               "config": {"latent": 96, "base": 160, "multipliers": [1, 1, 2, 4, 8], "res_blocks": 2, "heads": 4}},
//!   "transition": {
//!     "config": {"hidden": 384, "depth": 12, "heads": 6, "channels": 96, "patch": 1, "grid": [16, 16], "action_dim": 10},
//!     "weights": "dit-s.pt",
//!     "actions": {"frame_skip": 2},
//!     "sampler": {"steps": 10, "shift": 2.449, "context_tau": 0.01}
//!   },
//!   "probe": {
//!     "config": {"features": 96, "max_frames": 64},
//!     "weights": "probe.pt",
//!     "text": {"config": "siglip2/config.json", "weights": "siglip2/model.safetensors", "tokenizer": "siglip2/tokenizer.json"}
//!   }
//! }
//! ```
//!
//! With the encoder and decoder `autoencoder` or `taef2`, a folder has one of this project's own models: {"kind":
//! "autoencoder", "weights": "autoencoder.safetensors"}. The configuration is in the weights.
//!
//! [`Description`] has every field. Names of files are relative to the folder; a `config` is an object or the name of a
//! JSON file. A transition with several `views` has as many pictures, and latents, side by side along the width.
//!
//! Opening a folder reads names and shapes of all tensors, and refuses what does not fit together before a value is
//! read. The hash of the latent space is over encoder and adapter (kind, configuration, every tensor that they ask for,
//! as f32), normalisation, picture size, fit (unless it is `stretch`), views and number format: not over file formats, nor
//! what else a file holds.
//!
//! Encoder, decoder and transition model compute on the device of a [`Compute`], everything else on the CPU.

mod decoder;
mod description;
mod encoder;
mod fit;
mod native;
mod open;
mod own;
mod probe;
mod random;
mod source;
mod summary;
mod views;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use sha2::{Digest as _, Sha256};
use wm_model::WorldModel;
use wm_model::autoencoder::Normalisation;
use wm_model::transition::{Transition, TransitionConfig};
use wm_model::{Compute, Decoder, Encoder, Framing, LatentSpace, NumberFormat};
use wm_motion::actions::ActionEncoding;

pub use description::{
    Configuration, DecoderPart, Description, Part, ProbePart, Statistics, TextPart, TransitionPart,
};
pub use native::NativeDecoder;
pub use own::describe_autoencoder;
pub(crate) use own::{REQUIRED_FROM, open_own};
pub use random::write_random_weights;
pub use summary::{PartSummary, Stepping, Summary};

use crate::calibration::{Calibration, Origin, RangeRecorder};
use crate::kinds::{Canonical, DitConfig, EncoderConfig, load_transition};
use crate::loader::Requested;
use crate::success_probe::SuccessClassifier;
use crate::svae::{Svae, SvaeConfig};
use crate::{Error, Result, TransitionTensors};
use decoder::{DecoderConfig, FolderDecoder};
use encoder::FolderEncoder;
use fit::{check_decoder, check_transition, latent};
use open::{
    open_adapter, open_decoder, open_encoder, open_transition, statistics, transition_part,
};
use probe::Probe;
use source::{KnownInputs, Source};

/// Name of the description in a folder.
pub const FILE: &str = "model.json";

/// A part's files, what they hold, and what the model asks of them.
#[derive(Clone, Debug)]
struct Opened<C> {
    source: Source,
    config: C,
    tensors: Vec<Requested>,
}

/// A transition's configuration in both forms, and the actions that it takes.
#[derive(Clone, Debug)]
struct Dynamics {
    dit: DitConfig,
    config: TransitionConfig,
    encoding: ActionEncoding,
}

/// The decoder, and the adapter in front of it.
#[derive(Clone, Debug)]
struct Pictures {
    decoder: Opened<DecoderConfig>,
    adapter: Option<Opened<SvaeConfig>>,
}

/// An open folder of published networks, checked as a whole; each part reads its values when it is loaded.
#[derive(Debug)]
pub struct DescribedFolder {
    /// Its path, as it was opened.
    name: String,
    description: Description,
    encoder: Opened<Arc<dyn EncoderConfig>>,
    adapter: Option<Opened<SvaeConfig>>,
    normalisation: Normalisation,
    pictures: Option<Pictures>,
    transition: Option<Opened<Dynamics>>,
    /// The latent space of the training, for a transition beside the description.
    trained_on: Option<LatentSpace>,
    /// Camera views side by side.
    views: usize,
    probe: Option<Probe>,
    /// Ranges of the inputs of its matrices.
    known: KnownInputs,
    /// Rows, columns and channels of a latent, all views together.
    latent: [usize; 3],
    /// Computed once: it takes reading the encoder's values.
    space: OnceLock<LatentSpace>,
}

impl DescribedFolder {
    /// Whether `folder` is a model of this form.
    pub(crate) fn is_one(folder: &Path) -> bool {
        folder.join(FILE).is_file()
    }

    /// Opens a folder.
    ///
    /// # Errors
    /// If a file is missing or not valid, a part's tensors are not those of its configuration, or parts do not fit
    /// together: both are named then.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self> {
        let folder: PathBuf = folder.into();
        let path = folder.join(FILE);
        let file = path.display().to_string();
        let description = Description::read(&path)?;
        let error_of = |role, error| Error::Part {
            file: file.clone(),
            role,
            reason: Box::new(error),
        };
        let in_part = |role| move |error| error_of(role, error);

        let encoder = open_encoder(&description, &folder).map_err(in_part("encoder"))?;
        let adapter = open_adapter(description.adapter.as_ref(), &folder, "adapter")
            .map_err(in_part("adapter"))?;
        let (part, trained_on) =
            transition_part(&description, &folder).map_err(in_part("transition"))?;
        let transition = part
            .map(|part| open_transition(&part, &folder))
            .transpose()
            .map_err(in_part("transition"))?;
        let pictures = open_decoder(&description, &folder).map_err(in_part("decoder"))?;
        let probe = match &description.probe {
            None => None,
            Some(part) => Some(Probe::open(part, &folder, error_of)?),
        };

        let features = encoder
            .config
            .features(description.image)
            .map_err(in_part("encoder"))?;
        let views = match (&transition, description.views) {
            (None, views) => views.unwrap_or(1),
            (Some(transition), None) => transition.config.dit.views,
            (Some(transition), Some(views)) if transition.config.dit.views == views => views,
            (Some(transition), Some(views)) => {
                let taken = transition.config.dit.views;
                return Err(Error::ConfigFile {
                    file,
                    reason: format!("views is {views}, the transition takes {taken}"),
                });
            }
        };
        let latent = latent(features, adapter.as_ref(), views)
            .and_then(|latent| {
                if let Some(transition) = &transition {
                    check_transition(&description, latent, &transition.config)?;
                }
                if let Some(pictures) = &pictures {
                    check_decoder(&description, latent, pictures)?;
                }
                if let Some(probe) = &probe {
                    probe.check(&description, latent)?;
                }
                Ok(latent)
            })
            .map_err(|reason| Error::ConfigFile {
                file: file.clone(),
                reason,
            })?;
        let [_, _, channels] = latent;
        let normalisation =
            statistics(&description, &folder, channels).map_err(in_part("normalisation"))?;
        let mut opened = Self {
            name: folder.display().to_string(),
            description,
            encoder,
            adapter,
            normalisation,
            pictures,
            transition,
            trained_on,
            views,
            probe,
            known: KnownInputs::Nothing,
            latent,
            space: OnceLock::new(),
        };
        if opened.description.dtype == NumberFormat::Int8 {
            opened.known = opened.calibrated(&folder)?;
        }
        Ok(opened)
    }

    /// The calibration in `folder`, which has to be of these weights.
    fn calibrated(&self, folder: &Path) -> Result<KnownInputs> {
        let Some(calibration) = Calibration::read(folder)? else {
            tracing::info!(
                "{}: int8 without a calibration: wm model calibrate {} --bag BAG makes one",
                self.name,
                self.name
            );
            return Ok(KnownInputs::Nothing);
        };
        for source in self.sources() {
            calibration.check(folder, source.role, &source.fingerprint())?;
        }
        Ok(KnownInputs::Calibrated(calibration))
    }

    /// The checkpoints of all parts.
    fn sources(&self) -> Vec<&Source> {
        let mut sources = vec![&self.encoder.source];
        sources.extend(self.adapter.as_ref().map(|part| &part.source));
        sources.extend(self.transition.as_ref().map(|part| &part.source));
        if let Some(Pictures { decoder, adapter }) = &self.pictures {
            sources.push(&decoder.source);
            sources.extend(adapter.as_ref().map(|part| &part.source));
        }
        sources.extend(self.probe.iter().flat_map(Probe::sources));
        sources
    }

    /// The same, whose parts compute in f32 and record the inputs of their matrices, for
    /// [`Self::calibration`].
    pub fn recorded(mut self) -> Self {
        self.known = KnownInputs::Recorded(RangeRecorder::default());
        self.description.dtype = NumberFormat::F32;
        // It may be of another number format.
        self.space = OnceLock::new();
        self
    }

    /// The same, whose parts compute in int8, with `calibration` or none.
    pub fn quantised(mut self, calibration: Option<Calibration>) -> Self {
        self.known = match calibration {
            Some(calibration) => KnownInputs::Calibrated(calibration),
            None => KnownInputs::Nothing,
        };
        self.description.dtype = NumberFormat::Int8;
        self.space = OnceLock::new();
        self
    }

    /// The ranges since it is [recorded](Self::recorded).
    ///
    /// # Errors
    /// If no input was recorded, or one is not finite.
    pub fn calibration(&self, origin: Origin) -> Result<Calibration> {
        let KnownInputs::Recorded(recorder) = &self.known else {
            let reason = "the model does not record".to_owned();
            return Err(wm_model::Error::config("calibration", reason).into());
        };
        let weights = self.sources().into_iter();
        let weights = weights.map(|source| (source.role.to_owned(), source.fingerprint()));
        recorder.calibration(origin, weights.collect())
    }

    /// Its path, as it was opened.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its `model.json`.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The space of its latents; the first call reads the values of encoder and adapter, to hash them.
    ///
    /// # Errors
    /// If a value is not finite.
    pub fn space(&self) -> Result<LatentSpace> {
        if let Some(space) = self.space.get() {
            return Ok(space.clone());
        }
        let space = self.space_in(self.description.dtype)?;
        Ok(self.space.get_or_init(|| space).clone())
    }

    /// The space that its latents are in with weights of this number format.
    fn space_in(&self, format: NumberFormat) -> Result<LatentSpace> {
        self.space_of(
            self.description.name.clone(),
            (self.latent, format),
            self.adapter.as_ref(),
            &self.normalisation,
        )
    }

    /// The space of its latents as something knows them that was trained on `trained_on`: in another number format, if those
    /// are the same but for that; otherwise in its own.
    ///
    /// # Errors
    /// If a value is not finite.
    pub(crate) fn space_of_training(&self, trained_on: &LatentSpace) -> Result<LatentSpace> {
        let own = self.space()?;
        if own.hash == trained_on.hash || self.description.dtype == NumberFormat::F32 {
            return Ok(own);
        }
        let trained = self.space_in(NumberFormat::F32)?;
        Ok(match trained.hash == trained_on.hash {
            true => trained,
            false => own,
        })
    }

    /// Loads encoder and adapter.
    ///
    /// # Errors
    /// If a value is not finite, or the device cannot be used or has no memory for it.
    pub fn encoder(&self, compute: &Compute) -> Result<Box<dyn Encoder>> {
        let compute = self.in_own_format(compute)?;
        Ok(Box::new(FolderEncoder {
            network: self.encoder.source.load(&compute, &self.known, |loader| {
                self.encoder.config.load(loader)
            })?,
            device: compute.device()?.clone(),
            adapter: load_adapter(self.adapter.as_ref(), &compute, &self.known)?,
            normalisation: self.normalisation.clone(),
            image: self.description.image,
            views: self.views,
            fit: self.description.fit,
            space: self.space()?,
        }))
    }

    /// Loads the decoder; `None` where the model has none.
    ///
    /// # Errors
    /// If a value is not finite, or the device cannot be used or has no memory for it.
    pub fn decoder(&self, compute: &Compute) -> Result<Option<Box<dyn Decoder>>> {
        let Some(Pictures { decoder, adapter }) = &self.pictures else {
            return Ok(None);
        };
        let compute = self.in_own_format(compute)?;
        Ok(Some(Box::new(FolderDecoder {
            network: decoder
                .source
                .load(&compute, &self.known, |loader| decoder.config.load(loader))?,
            device: compute.device()?.clone(),
            adapter: load_adapter(adapter.as_ref(), &compute, &self.known)?,
            normalisation: self.normalisation.clone(),
            upsampling: decoder.config.upsampling()?,
            views: self.views,
            space: self.space()?,
        })))
    }

    /// How pictures become those of its encoder, without loading it.
    pub fn framing(&self) -> Framing {
        let [height, width] = self.description.image;
        Framing {
            size: (height, width * self.views),
            views: self.views,
            fit: self.description.fit,
        }
    }

    /// Whether there is a transition model; without one it encodes and decodes only.
    pub fn has_transition(&self) -> bool {
        self.transition.is_some()
    }

    /// How the transition model takes actions; `None` if there is no transition model.
    pub fn action_encoding(&self) -> Option<&ActionEncoding> {
        let transition = self.transition.as_ref()?;
        Some(&transition.config.encoding)
    }

    fn described_transition(&self) -> Result<&Opened<Dynamics>> {
        self.transition.as_ref().ok_or_else(|| Error::NoTransition {
            name: self.name.clone(),
        })
    }

    /// The tensors of the transition model, as f32.
    ///
    /// # Errors
    /// If there is none, or a value is not finite.
    pub fn transition_tensors(&self) -> Result<TransitionTensors> {
        let transition = self.described_transition()?;
        let Dynamics {
            config, encoding, ..
        } = &transition.config;
        let mut tensors = BTreeMap::new();
        let nothing = KnownInputs::Nothing;
        transition
            .source
            .load(&Compute::default(), &nothing, |loader| {
                Transition::build(config.clone(), &mut |parameter| {
                    let tensor = loader.tensor(&parameter.name, &parameter.shape)?;
                    tensors.insert(parameter.name.clone(), tensor.clone());
                    Ok(tensor)
                })?;
                Ok(())
            })?;
        Ok(TransitionTensors {
            config: config.clone(),
            encoding: encoding.clone(),
            tensors,
        })
    }

    /// Loads the transition model.
    ///
    /// # Errors
    /// If there is none, a value is not finite, it was trained on latents of another space, or the device cannot be used or
    /// has no memory for it.
    pub fn world_model(&self, compute: &Compute) -> Result<WorldModel> {
        let transition = self.described_transition()?;
        let Dynamics {
            config, encoding, ..
        } = &transition.config;
        let space = self.space()?;
        if let Some(trained_on) = &self.trained_on {
            trained_on.require(&self.space_of_training(trained_on)?)?;
        }
        let compute = self.in_own_format(compute)?;
        let model = transition.source.load(&compute, &self.known, |loader| {
            load_transition(config.clone(), loader, &compute)
        })?;
        let mut hash = Sha256::new();
        let settings = (config, encoding, &space, self.description.dtype);
        hash.update(format!("{}\n", settings.canonical()?));
        transition.source.hash(&transition.tensors, &mut hash)?;
        self.hash_ranges(&transition.source, &mut hash);
        Ok(WorldModel {
            name: self.name.clone(),
            transition: model,
            hash: format!("{:x}", hash.finalize()),
            space,
            encoding: encoding.clone(),
        })
    }

    /// Loads the success probe, its text tower and its tokenizer; `None` where the model has none.
    ///
    /// # Errors
    /// If a value is not finite, or the tokenizer is not one, or not of the text tower.
    pub fn probe(&self) -> Result<Option<SuccessClassifier>> {
        let compute = self.in_own_format(&Compute::default())?;
        let load = |probe: &Probe| probe.load(&compute, &self.known, self.normalisation.clone());
        self.probe.as_ref().map(load).transpose()
    }

    /// `compute` in the number format of the model.
    fn in_own_format(&self, compute: &Compute) -> Result<Compute> {
        Ok(compute.clone().with_format(self.description.dtype)?)
    }
}

fn load_adapter(
    adapter: Option<&Opened<SvaeConfig>>,
    compute: &Compute,
    known: &KnownInputs,
) -> Result<Option<Svae>> {
    let load = |Opened { source, config, .. }: &Opened<SvaeConfig>| {
        source.load(compute, known, |loader| Svae::load(config, loader))
    };
    adapter.map(load).transpose()
}

#[cfg(test)]
mod tests;
