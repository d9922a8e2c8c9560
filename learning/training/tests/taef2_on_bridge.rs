//! The published TAEF2 weights on real Bridge V2 episodes. Neither is part of this repository: the test reads the folders
//! `WM_TAEF2_DIR` (taef2_encoder.safetensors, taef2_decoder.safetensors) and `WM_BRIDGE_DIR` (episodes as NNN.mp4 +
//! NNN.npz), and is skipped with a message if they are not given.

use std::{env, path::PathBuf};

use wm_dataset::Dataset;
use wm_import::{ImportOptions, import_bridge};
use wm_model::{Autoencoder, Weights};
use wm_training::autoencoder::evaluate;

fn folder(variable: &str) -> Option<PathBuf> {
    let folder = env::var_os(variable).map(PathBuf::from);
    if folder.is_none() {
        eprintln!("skipped: {variable} is not set");
    }
    folder
}

#[test]
fn taef2_reconstructs_real_frames_at_32_db() {
    let (Some(weights), Some(episodes)) = (folder("WM_TAEF2_DIR"), folder("WM_BRIDGE_DIR")) else {
        return;
    };
    let half = |name: &str| Weights::open(weights.join(name)).unwrap();
    let autoencoder = Autoencoder::from_taef2(
        half("taef2_encoder.safetensors"),
        half("taef2_decoder.safetensors"),
        (256, 256),
    )
    .unwrap();
    let scratch = tempfile::tempdir().unwrap();
    let bags = scratch.path().join("bags");
    import_bridge(&episodes, &bags, &ImportOptions::default()).unwrap();
    let dataset = Dataset::open(&bags, &scratch.path().join("cache"), (256, 256)).unwrap();
    let reconstruction = evaluate(&autoencoder, &dataset, 14).unwrap();
    println!("{reconstruction}");
    assert!(reconstruction.psnr >= 32.0, "{reconstruction}");
}
