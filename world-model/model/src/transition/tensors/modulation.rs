//! Shifts, scales and gates of every layer.

use candle_core::Tensor;

use super::KERNELS;
use crate::ops::token_layers::{TensorLayers, TokenLayers as _};
use crate::transition::Transition;
use crate::transition::values::Batched;
use crate::{Error, Result};

/// What noise levels and actions make of every layer, for many frames in one product a layer.
#[derive(Clone, Debug)]
pub(crate) struct Modulation {
    batch: usize,
    entries: usize,
    /// (entries, sub-blocks, B, 6 d): those of an entry lie together.
    sub_blocks: Tensor,
    /// (entries, B, 2 d) of the plain head; the wide one makes its own.
    head: Option<Tensor>,
    /// Time embeddings (entries, B, d).
    time: Tensor,
}

/// The modulation of the frames of a pass, in the order of candidates and of frames.
#[derive(Clone, Debug)]
pub(super) struct OfFrames {
    /// (sub-blocks, B F, 6 d).
    pub(super) sub_blocks: Tensor,
    /// (B F, 2 d).
    pub(super) head: Option<Tensor>,
    /// (B F, d).
    pub(super) time: Tensor,
}

impl Modulation {
    /// That of frames of these noise levels (B each) and actions (B, A each).
    pub(super) fn new(model: &Transition, frames: &[(&[f32], &Batched)]) -> Result<Self> {
        let batch = frames.first().map_or(0, |(tau, _)| tau.len());
        let (entries, width) = (frames.len(), model.config().action_dim);
        if batch == 0 {
            return Err(Error::Shape {
                what: "the new frames",
                expected: "1 or more, for a batch of 1 or more".into(),
                found: vec![entries, batch],
            });
        }
        let (mut taus, mut actions) = (Vec::new(), Vec::new());
        for (tau, action) in frames {
            let action = action.tensor()?;
            if tau.len() != batch || action.dims() != [batch, width] {
                return Err(Error::Shape {
                    what: "a new frame",
                    expected: format!("{batch} noise levels and {} of actions", batch * width),
                    found: vec![tau.len(), action.elem_count()],
                });
            }
            taus.extend_from_slice(tau);
            actions.push(action);
        }
        let tau = Tensor::from_vec(taus, entries * batch, model.device())?;
        let actions = Tensor::cat(&actions, 0)?;
        let mut layers = TensorLayers::new(KERNELS, batch);
        let waves = model.embedding.waves(&tau)?;
        let condition = model.network.condition.at(&mut layers, &waves, &actions)?;
        let by_entry = |rows: &Tensor| rows.reshape((entries, batch, ()));
        let parts = model.network.blocks.iter().flatten();
        let sub_blocks = parts
            .map(|part| {
                let rows = layers.linear(&part.modulation, &condition.activated)?;
                Ok(by_entry(&rows)?)
            })
            .collect::<Result<Vec<_>>>()?;
        let head = model
            .network
            .head
            .plain_modulation(&mut layers, &condition.activated)?
            .map(|rows| by_entry(&rows))
            .transpose()?;
        Ok(Self {
            batch,
            entries,
            sub_blocks: Tensor::stack(&sub_blocks, 1)?,
            head,
            time: by_entry(&condition.time)?,
        })
    }

    pub(super) fn batch(&self) -> usize {
        self.batch
    }

    /// Frames that it is for.
    pub(crate) fn entries(&self) -> usize {
        self.entries
    }

    /// That of the `chosen` entries.
    pub(super) fn of(&self, chosen: &[usize]) -> Result<OfFrames> {
        let head = self.head.as_ref().map(|head| gathered(head, chosen));
        Ok(OfFrames {
            sub_blocks: gathered(&self.sub_blocks, chosen)?,
            head: head.transpose()?,
            time: gathered(&self.time, chosen)?,
        })
    }
}

/// Of `values` (entries, .., B, width) the `chosen` ones, candidate by candidate: (.., B chosen, width).
fn gathered(values: &Tensor, chosen: &[usize]) -> Result<Tensor> {
    let entries = chosen
        .iter()
        .map(|entry| values.get(*entry))
        .collect::<candle_core::Result<Vec<_>>>()?;
    if let [entry] = entries.as_slice() {
        return Ok(entry.clone());
    }
    let candidates = values.rank() - 3;
    let side_by_side = Tensor::stack(&entries, candidates + 1)?;
    Ok(side_by_side.flatten(candidates, candidates + 1)?)
}

impl OfFrames {
    /// In memory of its own.
    pub(super) fn copied(&self) -> Result<Self> {
        Ok(Self {
            sub_blocks: self.sub_blocks.force_contiguous()?,
            head: self
                .head
                .as_ref()
                .map(Tensor::force_contiguous)
                .transpose()?,
            time: self.time.force_contiguous()?,
        })
    }

    /// Becomes `other`, of as many frames, in the memory that it has.
    pub(super) fn overwrite(&self, other: &Self) -> Result<()> {
        self.sub_blocks.slice_set(&other.sub_blocks, 0, 0)?;
        if let (Some(head), Some(other)) = (&self.head, &other.head) {
            head.slice_set(other, 0, 0)?;
        }
        Ok(self.time.slice_set(&other.time, 0, 0)?)
    }
}
