//! What a `model.json` says.

use std::path::Path;

use serde::Deserialize;
use wm_model::sampler::Sampler;
use wm_model::trained_folder::TRANSITION_FILE;
use wm_model::transition::{
    ACTIONS_KEY, ActionAlignment, CONFIG_KEY, LATENT_SPACE_KEY, Parametrisation, TransitionConfig,
};
use wm_model::{Fit, LatentSpace, NumberFormat, PictureSize, Weights};

use crate::kinds::{DitConfig, Kind};
use crate::{Error, Result};

/// Side of the paper's frames in pixels.
const FRAME_SIDE: usize = 256;

/// A world model as data: the content of a `model.json` (the [module](super) has an example).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// Name of the latent space, for people; nodes name it where they refuse another.
    pub name: String,
    /// Height and width in pixels that a camera picture of one view is resized to before it is encoded; 256x256, as in
    /// the paper, if absent. Vision transformers resize further, to the size of their own configuration.
    #[serde(default = "paper_image")]
    pub image: [usize; 2],
    /// How pictures of another aspect become pictures of this size: `stretch`, `crop` or `pad`; `stretch`, as the published
    /// checkpoints were trained, if absent.
    #[serde(default)]
    pub fit: Fit,
    /// Size of the camera's pictures that the model was trained on, if it is known.
    #[serde(default)]
    pub trained_on: Option<PictureSize>,
    /// Number format of all weights: `bf16` halves their memory, `int8` quarters that of the matrices.
    #[serde(default)]
    pub dtype: NumberFormat,
    /// Pictures to latents: a [kind](crate::kinds) that gives `latent` for `image`; or, with a decoder of the same kind,
    /// `autoencoder` or `taef2`.
    pub encoder: Part,
    /// The S-VAE that takes the encoder's features to a compact latent.
    #[serde(default)]
    pub adapter: Option<Part>,
    /// Mean and standard deviation of each channel of the latent (behind the adapter); latents stay as they are where it
    /// is absent.
    #[serde(default)]
    pub normalisation: Option<Statistics>,
    /// Latents to pictures; a model without one predicts and plans all the same.
    #[serde(default)]
    pub decoder: Option<DecoderPart>,
    /// The next latent from the last ones and an action. Where it is absent, a `transition.safetensors` beside the
    /// description that `wm train transition` wrote is taken; without either, the model encodes and decodes only.
    #[serde(default)]
    pub transition: Option<TransitionPart>,
    /// Camera views that lie side by side in a picture; those of the transition where it is given, 1 if neither says.
    #[serde(default)]
    pub views: Option<usize>,
    /// What tells from latents whether an instruction is carried out; without it there are no success probabilities.
    #[serde(default)]
    pub probe: Option<ProbePart>,
}

/// A network of the model.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// Its kind, as `wm model forward` names it.
    pub kind: String,
    /// Its configuration; an autoencoder has it in its weights.
    #[serde(default)]
    pub config: Configuration,
    /// Its checkpoint, safetensors or a torch file, relative to the folder.
    pub weights: String,
}

/// A decoder, and what it takes instead of the latents themselves.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecoderPart {
    /// Its kind, as `wm model forward` names it.
    pub kind: String,
    /// Its configuration; an autoencoder has it in its weights.
    #[serde(default)]
    pub config: Configuration,
    /// Its checkpoint, safetensors or a torch file, relative to the folder.
    pub weights: String,
    /// An S-VAE through which latents go first: native latents to a pixel decoder of compact ones.
    #[serde(default)]
    pub adapter: Option<Part>,
}

/// A transition model and the conventions that its checkpoint does not state.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TransitionPart {
    /// A [`DitConfig`](crate::kinds::DitConfig).
    pub config: Configuration,
    /// Its checkpoint, relative to the folder.
    pub weights: String,
    /// An [`ActionEncoding`](wm_motion::actions::ActionEncoding). Where absent, `action_dim` is the configuration's,
    /// `accumulation` is `index`, as in the reference, and everything else is the reference's for Bridge V2.
    #[serde(default)]
    pub actions: serde_json::Map<String, serde_json::Value>,
    /// How to sample; ten steps with the published time shift if absent.
    #[serde(default)]
    pub sampler: Option<Sampler>,
    /// What the network's output stands for.
    #[serde(default = "velocity")]
    pub parametrisation: Parametrisation,
    /// Which action is fed with a frame.
    #[serde(default = "with_frame")]
    pub action_alignment: ActionAlignment,
}

/// A success probe, and what reads the instruction for it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProbePart {
    /// `success-probe`, the paper's and the default, or one of pooled latents: `linear-probe`, `temporal-probe` or
    /// `progress-probe`.
    #[serde(default = "success_probe")]
    pub kind: String,
    /// Its configuration, as `wm model forward` takes it.
    pub config: Configuration,
    /// Its checkpoint, relative to the folder.
    pub weights: String,
    /// SigLIP 2's text tower, for the `success-probe`; the others read no instruction.
    #[serde(default)]
    pub text: Option<TextPart>,
}

/// A text tower and its tokenizer.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextPart {
    /// Hugging Face's config.json (Siglip).
    pub config: Configuration,
    /// Its checkpoint, relative to the folder; it may hold the vision tower as well.
    pub weights: String,
    /// Hugging Face's tokenizer.json, relative to the folder.
    pub tokenizer: String,
}

/// A configuration: an object, or the name of a JSON file, relative to the folder.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a configuration as an object, or the name of a JSON file"
)]
pub enum Configuration {
    /// In a file of its own.
    File(String),
    /// In place.
    Object(serde_json::Map<String, serde_json::Value>),
}

/// Mean and standard deviation of each channel.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected {\"mean\": [..], \"std\": [..]}, or the name of a file of tensors"
)]
pub enum Statistics {
    /// A checkpoint with the tensors `latent_mean` and `latent_std`, relative to the folder.
    File(String),
    /// In place.
    Values {
        /// Mean of each channel.
        mean: Vec<f32>,
        /// Standard deviation of each channel.
        std: Vec<f32>,
    },
}

impl Description {
    /// Reads a `model.json`.
    ///
    /// # Errors
    /// If there is none, or it is not valid.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read(path)?;
        serde_json::from_str(&text).map_err(|error| Error::ConfigFile {
            file: path.display().to_string(),
            reason: error.to_string(),
        })
    }
}

impl Default for Configuration {
    fn default() -> Self {
        Self::Object(serde_json::Map::new())
    }
}

impl Configuration {
    /// Whether it has no value.
    pub(super) fn is_empty(&self) -> bool {
        matches!(self, Self::Object(values) if values.is_empty())
    }

    /// The configuration as JSON.
    ///
    /// # Errors
    /// If its file cannot be read.
    pub fn text(&self, folder: &Path) -> Result<String> {
        match self {
            Self::File(name) => read(&folder.join(name)),
            Self::Object(object) => Ok(serde_json::Value::Object(object.clone()).to_string()),
        }
    }
}

impl DecoderPart {
    /// The decoder alone.
    pub fn part(&self) -> Part {
        Part {
            kind: self.kind.clone(),
            config: self.config.clone(),
            weights: self.weights.clone(),
        }
    }
}

impl TransitionPart {
    /// The part that is a file of `wm train transition`, with the latent space that it was trained on.
    ///
    /// # Errors
    /// If the file or its metadata cannot be read.
    pub(super) fn trained(path: &Path) -> Result<(Self, LatentSpace)> {
        let weights = Weights::open(path)?;
        let config: TransitionConfig = weights.json(CONFIG_KEY)?;
        let malformed = |error: serde_json::Error| Error::ConfigFile {
            file: path.display().to_string(),
            reason: error.to_string(),
        };
        let object = |value: serde_json::Value| match value {
            serde_json::Value::Object(object) => object,
            _ => serde_json::Map::new(),
        };
        let dit = serde_json::to_value(DitConfig::of(&config)).map_err(malformed)?;
        let part = Self {
            config: Configuration::Object(object(dit)),
            weights: TRANSITION_FILE.to_owned(),
            actions: object(weights.json(ACTIONS_KEY)?),
            sampler: Some(config.sampler),
            parametrisation: config.parametrisation,
            action_alignment: config.action_alignment,
        };
        Ok((part, weights.json(LATENT_SPACE_KEY)?))
    }

    /// The network alone.
    pub fn part(&self) -> Part {
        Part {
            kind: Kind::Dit.name().to_owned(),
            config: self.config.clone(),
            weights: self.weights.clone(),
        }
    }
}

impl ProbePart {
    /// The probe alone.
    pub fn part(&self) -> Part {
        Part {
            kind: self.kind.clone(),
            config: self.config.clone(),
            weights: self.weights.clone(),
        }
    }
}

impl TextPart {
    /// The text tower alone.
    pub fn part(&self) -> Part {
        Part {
            kind: Kind::Siglip2Text.name().to_owned(),
            config: self.config.clone(),
            weights: self.weights.clone(),
        }
    }
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|error| Error::io(path, error))
}

fn success_probe() -> String {
    Kind::SuccessProbe.name().to_owned()
}

fn paper_image() -> [usize; 2] {
    [FRAME_SIDE; 2]
}

fn velocity() -> Parametrisation {
    Parametrisation::Velocity
}

fn with_frame() -> ActionAlignment {
    ActionAlignment::WithFrame
}
