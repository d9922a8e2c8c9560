//! A model that is small enough to be written by a test.

use std::path::Path;

use wm_model::{
    Autoencoder, AutoencoderConfig,
    transition::{ACTIONS_KEY, CONFIG_KEY, LATENT_SPACE_KEY, Transition, TransitionConfig},
    weights::{Precision, WeightsBuilder},
};
use wm_motion::actions::ActionEncoding;

/// Writes a model of random weights: 32x32 images, 4x4 latents.
pub fn write_model(folder: &Path) -> wm_model::LatentSpace {
    write_model_of_views(folder, 1)
}

/// The same, of other weights for each seed, and so of other latent spaces.
#[allow(dead_code, reason = "not every test has two models")]
pub fn write_model_of_seed(folder: &Path, seed: u64) -> wm_model::LatentSpace {
    write(folder, 1, seed)
}

/// The same, with `views` cameras side by side in an image.
pub fn write_model_of_views(folder: &Path, views: usize) -> wm_model::LatentSpace {
    write(folder, views, 1)
}

fn write(folder: &Path, views: usize, seed: u64) -> wm_model::LatentSpace {
    let config = AutoencoderConfig {
        name: "test".into(),
        height: 32,
        width: 32,
        ..AutoencoderConfig::tiny()
    };
    let autoencoder = Autoencoder::random(config, seed).unwrap();
    autoencoder
        .save(folder.join("autoencoder.safetensors"), Precision::F32)
        .unwrap();
    let space = Autoencoder::open(folder.join("autoencoder.safetensors"))
        .unwrap()
        .space()
        .clone();

    let config = TransitionConfig {
        hidden: 64,
        depth: 1,
        heads: 2,
        views,
        ..TransitionConfig::preset("tiny", space.shape(), 2, 7).unwrap()
    };
    let mut builder = WeightsBuilder::new();
    builder.metadata(CONFIG_KEY, serde_json::to_string(&config).unwrap());
    builder.metadata(LATENT_SPACE_KEY, serde_json::to_string(&space).unwrap());
    builder.metadata(
        ACTIONS_KEY,
        serde_json::to_string(&ActionEncoding::default()).unwrap(),
    );
    Transition::build(config, &mut |parameter| {
        let tensor = parameter.initial(2)?;
        builder.tensor(&parameter.name, &tensor, Precision::F32)?;
        Ok(tensor)
    })
    .unwrap();
    builder
        .write(folder.join("transition.safetensors"))
        .unwrap();
    space
}
