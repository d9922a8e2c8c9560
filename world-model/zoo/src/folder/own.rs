//! Folders whose encoder and decoder are an autoencoder of one training, or TAEF2.
//!
//! ```json
//! {
//!   "name": "mine",
//!   "image": [128, 128],
//!   "encoder": {"kind": "autoencoder", "weights": "autoencoder.safetensors"},
//!   "decoder": {"kind": "autoencoder", "weights": "autoencoder.safetensors"}
//! }
//! ```
//!
//! The kind `taef2` has the published halves, each in a file of its own. The transition model, the inverse dynamics model
//! and the probe of such a folder are the files of their trainings beside it. All compute in f32.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use wm_model::trained_folder::{AutoencoderFiles, TrainedFolder};
use wm_model::{Autoencoder, AutoencoderConfig, NumberFormat, Weights};

use super::{Description, FILE};
use crate::{Error, Result};

/// Kind of an autoencoder in one file, with its configuration in the file's metadata.
const AUTOENCODER: &str = "autoencoder";
/// Kind of the published halves of TAEF2.
const TAEF2: &str = "taef2";

/// First version of wm that reads no folder without a `model.json`.
pub(crate) const REQUIRED_FROM: &str = "0.3";

/// The folder of a `model.json` whose encoder is an autoencoder; `None` for published networks.
///
/// # Errors
/// If the description is invalid, has a part that does not go with an autoencoder, or differs from the weights.
pub(crate) fn open_own(folder: &Path) -> Result<Option<TrainedFolder>> {
    let path = folder.join(FILE);
    let description = Description::read(&path)?;
    let wrong = |reason: String| Error::ConfigFile {
        file: path.display().to_string(),
        reason,
    };
    let (encoder, decoder) = (&description.encoder, &description.decoder);
    let kind = encoder.kind.as_str();
    if ![AUTOENCODER, TAEF2].contains(&kind) {
        return Ok(None);
    }
    let Some(decoder) = decoder.as_ref().filter(|decoder| decoder.kind == kind) else {
        return Err(wrong(format!(
            "the encoder {kind} needs the decoder {kind}"
        )));
    };
    let others = [
        ("adapter", description.adapter.is_some()),
        ("normalisation", description.normalisation.is_some()),
        ("transition", description.transition.is_some()),
        ("views", description.views.is_some()),
        ("probe", description.probe.is_some()),
        ("dtype", description.dtype != NumberFormat::F32),
        ("decoder.adapter", decoder.adapter.is_some()),
        (
            "config",
            !encoder.config.is_empty() || !decoder.config.is_empty(),
        ),
    ];
    if let Some((key, _)) = others.into_iter().find(|(_, is_there)| *is_there) {
        return Err(wrong(format!(
            "`{key}` does not go with the encoder {kind}"
        )));
    }
    let [first, second] = [&encoder.weights, &decoder.weights].map(|file| folder.join(file));
    let (config, autoencoder) = if kind == TAEF2 {
        let [height, width] = description.image;
        let halves = AutoencoderFiles::Taef2 {
            halves: [first, second],
            size: (height, width),
        };
        (AutoencoderConfig::taef2(height, width), halves)
    } else {
        if first != second {
            return Err(wrong("encoder and decoder differ in `weights`".to_owned()));
        }
        let config = Weights::open(&first)?.json("config")?;
        (config, AutoencoderFiles::Whole(first))
    };
    let found = (&description.name, description.image, description.fit);
    let expected = (&config.name, [config.height, config.width], config.fit);
    if found != expected {
        return Err(wrong(format!(
            "name, image and fit are {found:?}, expected {expected:?} of the weights"
        )));
    }
    let folder = folder.to_owned();
    Ok(Some(TrainedFolder::Folder {
        folder,
        autoencoder,
    }))
}

/// The `model.json` of an autoencoder whose weights are `files` of a folder: one, or the two halves of TAEF2.
fn description(autoencoder: &Autoencoder, files: &[&str]) -> Value {
    let config = autoencoder.config();
    let (kind, encoder, decoder) = match files {
        [encoder, decoder] => (TAEF2, *encoder, *decoder),
        _ => (AUTOENCODER, Autoencoder::FILE, Autoencoder::FILE),
    };
    json!({
        "name": config.name,
        "image": [config.height, config.width],
        "fit": config.fit,
        "trained_on": config.trained_on,
        "encoder": {"kind": kind, "weights": encoder},
        "decoder": {"kind": kind, "weights": decoder},
    })
}

/// Writes the `model.json` of a folder with an autoencoder or the two files of TAEF2, unless there is one, and returns its
/// path.
///
/// # Errors
/// If the autoencoder cannot be read, or the file cannot be written.
pub fn describe_autoencoder(folder: &Path) -> Result<PathBuf> {
    let path = folder.join(FILE);
    if path.is_file() {
        return Ok(path);
    }
    let halves = Autoencoder::TAEF2_FILES;
    let is_whole = folder.join(Autoencoder::FILE).is_file();
    let has_halves = halves.iter().all(|half| folder.join(half).is_file());
    let files: &[&str] = match !is_whole && has_halves {
        true => &halves,
        false => &[Autoencoder::FILE],
    };
    let text = description(&Autoencoder::open(folder)?, files);
    std::fs::write(&path, format!("{text:#}\n")).map_err(|error| Error::io(&path, error))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use wm_model::trained_folder::{EMBEDDED, TRANSITION_FILE};
    use wm_model::weights::Precision;

    use super::*;
    use crate::ModelFolder;

    /// A folder as trainings wrote it up to version 0.1.
    fn old_folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let weights = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../model/weights")
            .join(EMBEDDED);
        for file in [Autoencoder::FILE, TRANSITION_FILE] {
            std::fs::copy(weights.join(file), folder.path().join(file)).unwrap();
        }
        folder
    }

    fn opened(folder: &Path) -> ModelFolder {
        ModelFolder::open(&folder.to_string_lossy()).unwrap()
    }

    fn identity(folder: &Path) -> (String, wm_model::LatentSpace) {
        let model = opened(folder).world_model().unwrap();
        (model.hash, model.space)
    }

    #[test]
    fn an_old_folder_is_read_and_converted_to_the_same_model() {
        let folder = old_folder();
        let old = identity(folder.path());
        let path = describe_autoencoder(folder.path()).unwrap();
        assert!(open_own(folder.path()).unwrap().is_some());
        assert_eq!(identity(folder.path()), old);
        let model = opened(folder.path());
        assert_eq!(model.space().unwrap(), old.1);
        assert!(model.described().is_none() && model.decoder().unwrap().is_some());
        assert_eq!(model.fit().unwrap(), wm_model::Fit::Stretch);

        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("{text} ")).unwrap();
        describe_autoencoder(folder.path()).unwrap();
        let kept = std::fs::read_to_string(&path).unwrap();
        assert_eq!(kept, format!("{text} "), "an existing file stays");
    }

    #[test]
    fn the_weights_may_have_any_name_and_place() {
        let (folder, elsewhere) = (old_folder(), tempfile::tempdir().unwrap());
        let path = describe_autoencoder(folder.path()).unwrap();
        let there = elsewhere.path().join("weights.safetensors");
        std::fs::rename(folder.path().join(Autoencoder::FILE), &there).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let there = there.to_string_lossy();
        std::fs::write(&path, text.replace(Autoencoder::FILE, &there)).unwrap();
        opened(folder.path()).world_model().unwrap();
    }

    #[test]
    fn the_halves_of_taef2_are_a_model() {
        let folder = tempfile::tempdir().unwrap();
        let random = Autoencoder::random(AutoencoderConfig::taef2(256, 256), 1).unwrap();
        let whole = folder.path().join("whole.safetensors");
        random.save(&whole, Precision::F16).unwrap();
        let tensors = candle_core::safetensors::load(&whole, &candle_core::Device::Cpu).unwrap();
        std::fs::remove_file(whole).unwrap();
        for (file, half) in Autoencoder::TAEF2_FILES
            .into_iter()
            .zip(["encoder.", "decoder."])
        {
            let of_half = tensors.iter().filter_map(|(name, tensor)| {
                Some((name.strip_prefix(half)?.to_owned(), tensor.clone()))
            });
            let of_half: std::collections::HashMap<_, _> = of_half.collect();
            candle_core::safetensors::save(&of_half, folder.path().join(file)).unwrap();
        }
        let old = opened(folder.path()).space().unwrap();
        describe_autoencoder(folder.path()).unwrap();
        assert!(open_own(folder.path()).unwrap().is_some());
        assert_eq!(opened(folder.path()).space().unwrap(), old);
    }

    #[test]
    fn a_description_that_differs_from_the_weights_is_refused() {
        let folder = old_folder();
        let path = describe_autoencoder(folder.path()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        for (key, value, expected) in [
            ("name", json!("other"), "expected (\"tiny\""),
            ("image", json!([64, 64]), "[128, 128]"),
            ("fit", json!("crop"), "Stretch"),
            ("dtype", json!("bf16"), "`dtype` does not go with"),
            ("views", json!(2), "`views` does not go with"),
            ("decoder", json!(null), "needs the decoder autoencoder"),
        ] {
            let mut changed: Value = serde_json::from_str(&text).unwrap();
            changed[key] = value;
            std::fs::write(&path, changed.to_string()).unwrap();
            let error = ModelFolder::open(&folder.path().to_string_lossy()).unwrap_err();
            let message = error.to_string();
            assert!(
                message.contains("model.json") && message.contains(expected),
                "{message}"
            );
        }
    }
}
