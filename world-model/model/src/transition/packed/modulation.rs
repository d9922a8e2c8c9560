//! Shifts, scales and gates of every layer.

use rayon::prelude::*;

use super::condition::product;
use super::{NewFrame, PackedTransition};
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
        let layers = &self.layers;
        let conditions = layers.condition.at(&taus, &actions);
        let rows = taus.len();
        let of = |linear| product(linear, &conditions.activated, rows);
        let sub_blocks = layers.sub_blocks.par_iter().map(|s| of(&s.modulation));
        Ok(Modulation {
            batch,
            entries: frames.len(),
            sub_blocks: sub_blocks.collect(),
            head: layers.head.plain_modulation().map(of),
            time: conditions.time,
        })
    }

    /// The modulation of whole frames, entry by entry.
    pub(super) fn modulate_frames(&self, frames: &[NewFrame<'_>]) -> Result<Modulation> {
        let frames: Vec<_> = frames.iter().map(|f| (f.tau, f.action)).collect();
        self.modulate(&frames)
    }
}
