//! World models whose encoder and decoder are an autoencoder of this crate: the embedded default, or a folder.
//!
//! The transition model, the inverse dynamics model and the probe of a folder are the files of their trainings beside the
//! autoencoder; each of them may be missing.

use std::path::{Path, PathBuf};

use crate::{
    Autoencoder, Compute, Error, LatentSpace, NumberFormat, PictureSize, Result, Weights,
    WorldModel,
    transition::{ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition},
};
use wm_motion::actions::ActionEncoding;

/// Name of the embedded default.
pub const EMBEDDED: &str = "tiny";

/// The file of the transition model in a folder.
pub const TRANSITION_FILE: &str = "transition.safetensors";
/// The file of the inverse dynamics model in a folder.
pub const IDM_FILE: &str = "idm.safetensors";
/// The file of the success probe in a folder.
pub const PROBE_FILE: &str = "probe.safetensors";
/// The file of the model of subgoals in a folder.
pub const SUBGOALS_FILE: &str = "subgoals.safetensors";
/// The file of the learnt distance in a folder.
pub const DISTANCE_FILE: &str = "distance.safetensors";

/// Metadata key of the [`PictureSize`] (JSON) of the camera's pictures that a network was trained on.
pub const TRAINED_ON_KEY: &str = "trained_on";

/// The simulator's pictures, which [`EMBEDDED`] was trained on.
const EMBEDDED_TRAINED_ON: PictureSize = PictureSize {
    width: 256,
    height: 256,
};

static EMBEDDED_AUTOENCODER: &[u8] = include_bytes!("../weights/tiny/autoencoder.safetensors");
static EMBEDDED_TRANSITION: &[u8] = include_bytes!("../weights/tiny/transition.safetensors");
static EMBEDDED_IDM: &[u8] = include_bytes!("../weights/tiny/idm.safetensors");
static EMBEDDED_PROBE: &[u8] = include_bytes!("../weights/tiny/probe.safetensors");

/// The files of a world model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TrainedFolder {
    /// The default that is part of the program.
    Embedded,
    /// A folder of weights.
    Folder {
        /// The folder, or the file of an autoencoder alone.
        folder: PathBuf,
        /// Encoder and decoder.
        autoencoder: AutoencoderFiles,
    },
}

/// The files of an autoencoder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AutoencoderFiles {
    /// Both halves in one file, or a folder, as [`Autoencoder::open`] takes them.
    Whole(PathBuf),
    /// The published halves of TAEF2.
    Taef2 {
        /// The encoder's file and the decoder's.
        halves: [PathBuf; 2],
        /// Height and width of the pictures.
        size: (usize, usize),
    },
}

impl AutoencoderFiles {
    fn open(&self) -> Result<Autoencoder> {
        match self {
            Self::Whole(path) => Autoencoder::open(path),
            Self::Taef2 {
                halves: [encoder, decoder],
                size,
            } => Autoencoder::from_taef2(Weights::open(encoder)?, Weights::open(decoder)?, *size),
        }
    }
}

impl TrainedFolder {
    /// [`EMBEDDED`] is the default; any other name is a folder with the usual names of files, or the file of an
    /// autoencoder.
    #[must_use]
    pub fn named(name: &str) -> Self {
        if name == EMBEDDED {
            Self::Embedded
        } else {
            Self::Folder {
                folder: PathBuf::from(name),
                autoencoder: AutoencoderFiles::Whole(PathBuf::from(name)),
            }
        }
    }

    /// Its name, for [`Self::named`].
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Embedded => EMBEDDED.to_owned(),
            Self::Folder { folder, .. } => folder.display().to_string(),
        }
    }

    /// Loads encoder and decoder.
    ///
    /// # Errors
    /// When a file is missing or corrupt, or a tensor in it is missing, misshapen or unexpected.
    pub fn autoencoder(&self) -> Result<Autoencoder> {
        match self {
            Self::Embedded => Autoencoder::from_weights(Weights::from_static(
                "embedded autoencoder",
                EMBEDDED_AUTOENCODER,
            )?),
            Self::Folder { autoencoder, .. } => autoencoder.open(),
        }
    }

    /// Size of the camera's pictures that the model was trained on: those of the transition model, or else of the
    /// autoencoder; `None` if it is not known.
    ///
    /// # Errors
    /// When a file is corrupt.
    pub fn trained_on(&self) -> Result<Option<PictureSize>> {
        if *self == Self::Embedded {
            return Ok(Some(EMBEDDED_TRAINED_ON));
        }
        let transition = self.weights(TRANSITION_FILE)?;
        match transition_trained_on(transition.as_ref())? {
            Some(size) => Ok(Some(size)),
            None => Ok(self.autoencoder()?.config().trained_on),
        }
    }

    /// Whether there is a transition model beside encoder and decoder.
    #[must_use]
    pub fn has_transition(&self) -> bool {
        match self {
            Self::Embedded => true,
            Self::Folder { folder, .. } => folder.join(TRANSITION_FILE).exists(),
        }
    }

    /// Another file of a training, as [`IDM_FILE`]; `None` if it does not exist.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn weights(&self, file: &str) -> Result<Option<Weights>> {
        match self {
            Self::Embedded => match file {
                IDM_FILE => Weights::from_static("embedded inverse dynamics model", EMBEDDED_IDM),
                PROBE_FILE => Weights::from_static("embedded success probe", EMBEDDED_PROBE),
                _ => return Ok(None),
            }
            .map(Some),
            Self::Folder { folder, .. } => weights_in(folder, file),
        }
    }

    /// The weights of the transition model, with its metadata.
    ///
    /// # Errors
    /// When the file is missing or corrupt.
    pub fn transition(&self) -> Result<Weights> {
        match self {
            Self::Embedded => Weights::from_static("embedded transition", EMBEDDED_TRANSITION),
            // A file may be given in place of its folder.
            Self::Folder { folder, .. } if folder.is_file() => Weights::open(folder),
            Self::Folder { folder, .. } => Weights::open(folder.join(TRANSITION_FILE)),
        }
    }

    /// Loads the transition model, and checks that it belongs to the autoencoder beside it.
    ///
    /// # Errors
    /// As [`Self::autoencoder`]; when the model was trained in another latent space; and when the device cannot be used or
    /// has no memory for it.
    pub fn world_model(&self, compute: &Compute) -> Result<WorldModel> {
        let weights = self.transition()?;
        let space = self.autoencoder()?.space().clone();
        let trained_on: LatentSpace = weights.json(LATENT_SPACE_KEY)?;
        if trained_on.hash != space.hash {
            return Err(Error::WrongHash {
                file: weights.file().to_owned(),
                what: "the latent space that the transition model was trained on",
                expected: space.hash,
                found: trained_on.hash,
            });
        }
        let encoding: ActionEncoding = weights.json(ACTIONS_KEY)?;
        let hash = weights.identity(&[CONFIG_KEY, ACTIONS_KEY, LATENT_SPACE_KEY])?;
        let file = weights.file().to_owned();
        let model = Transition::from_weights_on(weights, compute)?;
        let model = compute.load(model, NumberFormat::F32)?;
        let config = model.config();
        let disagrees = |key: &str, reason: String| Error::Metadata {
            file: file.clone(),
            key: key.to_owned(),
            reason,
        };
        let latent = (config.latent_height, config.latent_width, config.channels);
        if latent != space.shape() {
            let reason = format!(
                "latents of {latent:?}, expected {:?} of {space}",
                space.shape()
            );
            return Err(disagrees(CONFIG_KEY, reason));
        }
        let (told, taken) = (
            (encoding.action_dim(), encoding.frame_skip()),
            (config.action_dim, config.frame_skip),
        );
        if told != taken {
            let reason = format!(
                "actions of {} values and {} frames, expected {} and {} of the configuration",
                told.0, told.1, taken.0, taken.1
            );
            return Err(disagrees(ACTIONS_KEY, reason));
        }
        Ok(WorldModel {
            name: self.name(),
            transition: model,
            hash,
            space,
            encoding,
        })
    }
}

/// The file `file` that a training wrote into `folder`; `None` if it does not exist.
///
/// # Errors
/// When it cannot be read.
pub fn weights_in(folder: &Path, file: &str) -> Result<Option<Weights>> {
    match folder.join(file) {
        path if path.is_file() => Weights::open(path).map(Some),
        _ => Ok(None),
    }
}

/// Size of the camera's pictures that a transition model was trained on; `None` if it is not known.
///
/// # Errors
/// When its metadata is malformed.
pub fn transition_trained_on(transition: Option<&Weights>) -> Result<Option<PictureSize>> {
    match transition {
        Some(weights) if weights.metadata(TRAINED_ON_KEY).is_some() => {
            weights.json(TRAINED_ON_KEY).map(Some)
        }
        _ => Ok(None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_default_is_whole_small_and_of_one_latent_space() {
        let folder = TrainedFolder::named(EMBEDDED);
        let autoencoder = folder.autoencoder().unwrap();
        let model = folder.world_model(&Compute::default()).unwrap();
        assert_eq!(&model.space, autoencoder.space());
        assert_eq!(model.hash.len(), 64);
        let config = model.transition.config();
        let space = autoencoder.space();
        assert_eq!(
            (config.latent_height, config.latent_width, config.channels),
            (space.height, space.width, space.channels)
        );
        assert_eq!(config.action_dim, model.encoding.action_dim());
        let sizes = [
            EMBEDDED_AUTOENCODER,
            EMBEDDED_TRANSITION,
            EMBEDDED_IDM,
            EMBEDDED_PROBE,
        ]
        .map(<[u8]>::len);
        assert!(sizes.iter().sum::<usize>() <= 12_000_000, "{sizes:?}");
        assert!(EMBEDDED_IDM.len() <= 2_000_000);
    }

    #[test]
    fn a_transition_of_another_latent_space_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let other = Autoencoder::random(
            TrainedFolder::Embedded
                .autoencoder()
                .unwrap()
                .config()
                .clone(),
            1,
        )
        .unwrap();
        other
            .save(
                folder.path().join("autoencoder.safetensors"),
                crate::weights::Precision::F16,
            )
            .unwrap();
        std::fs::write(folder.path().join(TRANSITION_FILE), EMBEDDED_TRANSITION).unwrap();
        let error = TrainedFolder::named(&folder.path().to_string_lossy())
            .world_model(&Compute::default())
            .unwrap_err();
        assert!(error.to_string().contains("latent space"), "{error}");
    }

    #[test]
    fn a_missing_folder_is_named() {
        let error = TrainedFolder::named("/no/such/model")
            .autoencoder()
            .unwrap_err();
        assert!(error.to_string().contains("/no/such/model"), "{error}");
    }
}
