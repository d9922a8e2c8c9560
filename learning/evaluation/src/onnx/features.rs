//! Features of pictures and of clips.

use image::RgbImage;

use crate::onnx::batches::Batches;
use crate::onnx::pooling::pooled;
use crate::onnx::{Error, Network, OutputKind, Result};

/// A network for features of pictures: `fid`, `subject`, `background`, or `jepa` without `input.frames`.
#[derive(Debug)]
pub struct Features {
    network: Network,
    output: usize,
}

/// A network for features of clips: `fvd`, or `jepa` with `input.frames`.
#[derive(Debug)]
pub struct ClipFeatures {
    network: Network,
    output: usize,
    frames: usize,
}

impl Features {
    pub(crate) fn new(network: Network) -> Result<Self> {
        if network.role().output() != OutputKind::Features || network.input().frames.is_some() {
            return Err(other(&network, "features of pictures"));
        }
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(1, "pictures")?;
        Ok(Self { network, output })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// One vector per picture, in order, all of one length. Pictures may differ in size if `networks.yaml` has a size.
    pub fn of(&self, pictures: &[RgbImage]) -> Result<Vec<Vec<f32>>> {
        let network = &self.network;
        let mut features = Vec::with_capacity(pictures.len());
        for batch in Batches::new(pictures, network.batch()) {
            let prepared: Vec<_> = batch
                .iter()
                .map(|picture| network.prepare(picture))
                .collect::<Result<_>>()?;
            let input = network.arrange(&prepared, None)?;
            let outputs = network.run(&[input])?;
            let rows = pooled(network, &outputs, self.output, batch.len())?;
            features.extend(rows.into_iter().take(batch.given()));
        }
        Ok(features)
    }
}

impl ClipFeatures {
    pub(crate) fn new(network: Network) -> Result<Self> {
        let frames = network.input().frames;
        let Some(frames) = frames.filter(|_| network.role().output() == OutputKind::Features)
        else {
            return Err(other(&network, "features of clips"));
        };
        let output = network.index_of(&network.spec().output, "output")?;
        network.takes(1, "clips")?;
        Ok(Self {
            network,
            output,
            frames,
        })
    }

    /// The network, for reports.
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Pictures per clip.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// One vector per clip, in order, all of one length.
    pub fn of(&self, clips: &[&[RgbImage]]) -> Result<Vec<Vec<f32>>> {
        let network = &self.network;
        let mut features = Vec::with_capacity(clips.len());
        for batch in Batches::new(clips, network.batch()) {
            let mut prepared = Vec::with_capacity(batch.len() * self.frames);
            for clip in batch.iter() {
                if clip.len() != self.frames {
                    let (expected, found) = (self.frames.to_string(), clip.len().to_string());
                    return Err(network.wrong("pictures of a clip", expected, found));
                }
                for picture in *clip {
                    prepared.push(network.prepare(picture)?);
                }
            }
            let input = network.arrange(&prepared, Some(self.frames))?;
            let outputs = network.run(&[input])?;
            let rows = pooled(network, &outputs, self.output, batch.len())?;
            features.extend(rows.into_iter().take(batch.given()));
        }
        Ok(features)
    }
}

pub(crate) fn other(network: &Network, requested: &'static str) -> Error {
    Error::Role {
        role: network.role(),
        requested,
    }
}
