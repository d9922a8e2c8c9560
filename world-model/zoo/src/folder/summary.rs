//! What a model folder is, in figures.

use wm_model::Fit;

use super::DescribedFolder;
use super::probe::Probe;
use crate::Result;
use crate::cost::{self, Cost};
use crate::loader::Requested;

/// A part of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct PartSummary {
    /// What it is for the model.
    pub role: &'static str,
    /// Its kind.
    pub kind: String,
    /// Number of trained values.
    pub parameters: usize,
    /// Operations for one frame (of 256x256, as [`cost`] counts them); of the transition, for one Euler step; of the text
    /// tower, for an instruction; of the probe, for the longest episode.
    pub operations: usize,
}

/// The parts of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Encoder, adapter, transition, decoder, probe: those that there are.
    pub parts: Vec<PartSummary>,
    /// Rows, columns and channels of a latent.
    pub latent: [usize; 3],
    /// Height and width of the camera's picture, all views together.
    pub image: [usize; 2],
    /// How pictures of another aspect become such pictures.
    pub fit: Fit,
    /// Camera views side by side.
    pub views: usize,
    /// How it is stepped; `None` without a transition model.
    pub stepping: Option<Stepping>,
}

/// How a transition model is stepped.
#[derive(Clone, Debug, PartialEq)]
pub struct Stepping {
    /// Camera frames of a model step.
    pub frame_skip: usize,
    /// Euler steps a predicted frame.
    pub integration_steps: usize,
    /// Time shift of the sampler.
    pub shift: f64,
    /// Frames that the transition sees at most.
    pub max_frames: usize,
}

impl DescribedFolder {
    /// What it is made of; reads no values.
    ///
    /// # Errors
    /// If a part's cost cannot be counted.
    pub fn summary(&self) -> Result<Summary> {
        let part =
            |role, kind: crate::kinds::Kind, tensors: &[Requested], cost: Cost| PartSummary {
                role,
                kind: kind.to_string(),
                parameters: tensors.iter().map(Requested::count).sum(),
                operations: cost.operations,
            };
        let views = self.views;
        let mut parts = Vec::new();
        let encoder = &self.encoder;
        let cost = encoder.config.cost()?;
        parts.push(part("encoder", encoder.source.kind, &encoder.tensors, cost));
        if let Some(adapter) = &self.adapter {
            let cost = cost::adapter(&adapter.config)?;
            parts.push(part("adapter", adapter.source.kind, &adapter.tensors, cost));
        }
        if let Some(transition) = &self.transition {
            let cost = cost::transition(&transition.config.dit)?;
            let (kind, tensors) = (transition.source.kind, &transition.tensors);
            parts.push(part("transition", kind, tensors, cost));
        }
        if let Some(pictures) = &self.pictures {
            if let Some(adapter) = &pictures.adapter {
                let cost = cost::adapter(&adapter.config)?;
                let role = "decoder's adapter";
                parts.push(part(role, adapter.source.kind, &adapter.tensors, cost));
            }
            let decoder = &pictures.decoder;
            let cost = decoder.config.cost()?;
            parts.push(part("decoder", decoder.source.kind, &decoder.tensors, cost));
        }
        match &self.probe {
            None => {}
            Some(Probe::Pooled(probe)) => {
                let cost = cost::pooled_probe(&probe.config)?;
                parts.push(part("probe", probe.source.kind, &probe.tensors, cost));
            }
            Some(Probe::Instructed { probe, text }) => {
                let text = &text.tower;
                let cost = cost::siglip2_text(&text.config)?;
                parts.push(part("probe's text", text.source.kind, &text.tensors, cost));
                let length = text.config.max_position_embeddings;
                let cost = cost::success_probe(&probe.config, length)?;
                parts.push(part("probe", probe.source.kind, &probe.tensors, cost));
            }
        }
        let stepping = self.transition.as_ref().map(|transition| {
            let config = &transition.config.config;
            Stepping {
                frame_skip: config.frame_skip,
                integration_steps: config.sampler.steps,
                shift: config.sampler.shift,
                max_frames: config.max_frames,
            }
        });
        let [height, width] = self.description.image;
        Ok(Summary {
            parts,
            latent: self.latent,
            image: [height, width * views],
            fit: self.description.fit,
            views,
            stepping,
        })
    }
}
