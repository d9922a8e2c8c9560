//! Shifts, scales and gates of every layer.

use rayon::prelude::*;

use super::{NewFrame, PackedTransition};
use crate::ops::token_layers::{PackedLayers, Rows, TokenLayers as _};
use crate::transition::condition::frequencies;
use crate::{Error, Result};

/// What noise levels and actions make of every layer, computed for many frames in one product per layer: the weights of
/// the modulation are as many as those of the attention, and a frame alone would read them for one row.
#[derive(Clone, Debug)]
pub(crate) struct Modulation {
    pub(super) batch: usize,
    pub(super) entries: usize,
    /// Sub-block by sub-block: (entries, B, 6 d).
    pub(super) sub_blocks: Vec<Vec<f32>>,
    /// (entries, B, 2 d) of the plain head; the wide one makes its own.
    pub(super) head: Option<Vec<f32>>,
    /// Time embeddings (entries, B, d).
    pub(super) time: Vec<f32>,
}

impl Modulation {
    /// Frames that it is for.
    pub(crate) fn entries(&self) -> usize {
        self.entries
    }

    /// Rows of `values`, of which every entry has one a candidate, in the order of candidates and of `chosen` entries.
    pub(super) fn gathered(&self, values: &[f32], chosen: &[usize]) -> Vec<f32> {
        let width = values.len() / (self.entries * self.batch).max(1);
        let mut out = Vec::with_capacity(self.batch * chosen.len() * width);
        for b in 0..self.batch {
            for entry in chosen {
                let row = entry * self.batch + b;
                let row = values.get(row * width..(row + 1) * width);
                out.extend_from_slice(row.unwrap_or_default());
            }
        }
        out
    }
}

impl PackedTransition {
    /// The modulation of frames of these noise levels (B each) and actions (B, A each); entry i is that of the i-th.
    ///
    /// # Errors
    /// If there is no frame, or sizes do not fit the model or each other.
    pub(crate) fn modulate(&self, frames: &[(&[f32], &[f32])]) -> Result<Modulation> {
        let batch = frames.first().map_or(0, |(tau, _)| tau.len());
        let width = self.config.action_dim;
        let (mut taus, mut actions) = (Vec::new(), Vec::new());
        for (tau, action) in frames {
            if batch == 0 || tau.len() != batch || action.len() != batch * width {
                return Err(Error::Shape {
                    what: "a new frame",
                    expected: format!("{batch} noise levels and {} of actions", batch * width),
                    found: vec![tau.len(), action.len()],
                });
            }
            taus.extend_from_slice(tau);
            actions.extend_from_slice(action);
        }
        if batch == 0 {
            return Err(Error::Shape {
                what: "the new frames",
                expected: "1 or more, for a batch of 1 or more".into(),
                found: vec![frames.len(), batch],
            });
        }
        let frequencies = frequencies();
        let mut waves = Vec::with_capacity(taus.len() * 2 * frequencies.len());
        for tau in &taus {
            waves.extend(frequencies.iter().map(|f| (f * tau).cos()));
            waves.extend(frequencies.iter().map(|f| (f * tau).sin()));
        }
        let (waves, actions) = (
            Rows::shared(2 * frequencies.len(), &waves),
            Rows::shared(width, &actions),
        );
        let network = &self.layers;
        let mut layers = PackedLayers::default();
        let condition = network.condition.at(&mut layers, &waves, &actions)?;
        let parts = network.sub_blocks.par_iter().flatten();
        let sub_blocks = parts.map(|part| {
            let rows = PackedLayers::default().linear(&part.modulation, &condition.activated)?;
            Ok(rows.to_vec())
        });
        let head = network
            .head
            .plain_modulation(&mut layers, &condition.activated)?;
        Ok(Modulation {
            batch,
            entries: frames.len(),
            sub_blocks: sub_blocks.collect::<Result<_>>()?,
            head: head.map(|rows| rows.to_vec()),
            time: condition.time.to_vec(),
        })
    }

    /// The modulation of whole frames, entry by entry.
    pub(super) fn modulate_frames(&self, frames: &[NewFrame<'_>]) -> Result<Modulation> {
        let frames: Vec<_> = frames.iter().map(|f| (f.tau, f.action)).collect();
        self.modulate(&frames)
    }
}
