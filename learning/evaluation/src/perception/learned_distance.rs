use std::path::{Path, PathBuf};

use crate::onnx::{Digest, Distance};
use anyhow::{Context as _, Result};
use image::RgbImage;
use serde_json::{Map, Value};
use wm_model::image::preprocess;
use wm_zoo::lpips::Lpips;

/// Extensions of the files of `--lpips`, in order of preference.
const ENDINGS: [&str; 3] = ["safetensors", "pth", "pt"];

/// LPIPS from an ONNX file or from torch's files.
#[derive(Debug)]
pub(super) enum LearnedDistance {
    Network(Box<Distance>),
    AlexNet(Lpips),
}

impl LearnedDistance {
    /// AlexNet and the heads of a folder, with the digests of both.
    pub(super) fn open(folder: &Path) -> Result<(Self, Value)> {
        let mut digests = Map::new();
        let mut file = |name: &str| -> Result<PathBuf> {
            let path = found(folder, name)?;
            let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
            digests.insert(name.into(), Digest::of(&bytes).to_string().into());
            Ok(path)
        };
        let (trunk, heads) = (file("alexnet")?, file("heads")?);
        let lpips = Lpips::open(&trunk, &heads).context("--lpips")?;
        Ok((Self::AlexNet(lpips), digests.into()))
    }

    /// Distances of pairs of pictures of one size.
    pub(super) fn between<'a>(
        &self,
        pairs: impl Iterator<Item = (&'a RgbImage, &'a RgbImage)>,
    ) -> Result<Vec<f64>> {
        match self {
            Self::Network(network) => {
                let distances = network.between(&pairs.collect::<Vec<_>>())?;
                Ok(distances.into_iter().map(f64::from).collect())
            }
            Self::AlexNet(lpips) => pairs
                .map(|(a, b)| {
                    let tensor = |picture: &RgbImage| {
                        let (width, height) = picture.dimensions();
                        // The picture's own size: no resizing.
                        preprocess(picture, (height as usize, width as usize))
                    };
                    let distance = lpips.distance(&tensor(a)?, &tensor(b)?)?;
                    Ok(f64::from(distance.to_scalar::<f32>()?))
                })
                .collect(),
        }
    }
}

fn found(folder: &Path, name: &str) -> Result<PathBuf> {
    let paths = ENDINGS.map(|ending| folder.join(format!("{name}.{ending}")));
    let found = paths.into_iter().find(|path| path.is_file());
    found.with_context(|| {
        let endings = ENDINGS.join(", ");
        format!(
            "--lpips {}: expected {name} with one of the endings {endings}",
            folder.display()
        )
    })
}
