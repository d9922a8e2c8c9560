//! What earlier frames contribute to later ones.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use candle_core::Tensor;

use super::Parts;
use crate::Result;

/// Dimension of the frames in keys and values.
const FRAMES: usize = 3;

/// Keys, turned by their positions, and values of frames in one block: (B, N, heads, frames, dim) each.
#[derive(Clone, Debug)]
pub(super) struct KeysValues {
    pub(super) keys: Tensor,
    pub(super) values: Tensor,
}

impl KeysValues {
    /// Those of the first `count` frames, in memory of their own.
    pub(super) fn first(&self, count: usize) -> Result<Self> {
        self.map(|x| x.narrow(FRAMES, 0, count)?.contiguous())
    }

    /// Behind those of `earlier` frames, if there are any.
    pub(super) fn after(&self, earlier: Option<&Self>) -> Result<Self> {
        let Some(earlier) = earlier else {
            return Ok(self.clone());
        };
        Ok(Self {
            keys: Tensor::cat(&[&earlier.keys, &self.keys], FRAMES)?,
            values: Tensor::cat(&[&earlier.values, &self.values], FRAMES)?,
        })
    }

    /// How many frames.
    fn frames(&self) -> Result<usize> {
        Ok(self.keys.dim(FRAMES)?)
    }

    fn map(&self, change: impl Fn(&Tensor) -> candle_core::Result<Tensor>) -> Result<Self> {
        Ok(Self {
            keys: change(&self.keys)?,
            values: change(&self.values)?,
        })
    }

    /// In memory of their own.
    fn copied(&self) -> Result<Self> {
        self.map(Tensor::force_contiguous)
    }

    /// Writes over these.
    fn overwrite(&self, with: &Self) -> Result<()> {
        self.keys.slice_set(&with.keys, 0, 0)?;
        self.values.slice_set(&with.values, 0, 0)?;
        Ok(())
    }
}

/// What a pass keeps of its first frames.
#[derive(Debug)]
pub(super) struct Kept {
    model: Arc<Parts>,
    /// Of no other one in this process.
    number: u64,
    batch: usize,
    /// Block by block.
    layers: Vec<KeysValues>,
}

impl Kept {
    pub(super) fn new(model: Arc<Parts>, batch: usize, layers: Vec<KeysValues>) -> Self {
        static MADE: AtomicU64 = AtomicU64::new(0);
        Self {
            model,
            number: MADE.fetch_add(1, Ordering::Relaxed),
            batch,
            layers,
        }
    }
}

/// One frame as later ones see it.
#[derive(Clone, Debug)]
pub(crate) struct FrameContext {
    kept: Arc<Kept>,
    /// Which of the frames that were computed together.
    index: usize,
}

impl FrameContext {
    pub(super) fn new(kept: &Arc<Kept>, index: usize) -> Self {
        let kept = Arc::clone(kept);
        Self { kept, index }
    }

    /// Number of candidates that it was computed for.
    pub(crate) fn batch(&self) -> usize {
        self.kept.batch
    }

    pub(super) fn is_of(&self, model: &Arc<Parts>) -> bool {
        Arc::ptr_eq(&self.kept.model, model)
    }

    fn name(&self) -> (u64, usize) {
        (self.kept.number, self.index)
    }
}

/// The contexts of earlier frames, side by side for every block.
#[derive(Clone, Debug)]
pub(super) struct Earlier {
    /// Which ones.
    names: Vec<(u64, usize)>,
    batch: usize,
    layers: Vec<EarlierLayer>,
}

/// Of one block. In which order a query sees keys makes no difference: their positions are in them.
#[derive(Clone, Debug)]
pub(super) struct EarlierLayer {
    /// Of a batch of 1, which all candidates share.
    pub(super) shared: Option<KeysValues>,
    /// Each candidate's own.
    pub(super) own: Option<KeysValues>,
}

/// Frames that are shared, and others: what decides the shapes of a pass, with its batch.
pub(super) type Counts = (usize, usize);

impl Earlier {
    /// The `contexts` for a pass of `batch` candidates, for all of a model's blocks.
    pub(super) fn new(contexts: &[&FrameContext], batch: usize, depth: usize) -> Result<Self> {
        let layers = (0..depth)
            .map(|layer| {
                let all = |is_shared: bool| -> Result<Option<KeysValues>> {
                    let of =
                        |context: &&&FrameContext| (context.batch() == 1 && batch > 1) == is_shared;
                    side_by_side(contexts.iter().filter(of).copied(), layer)
                };
                Ok(EarlierLayer {
                    shared: all(true)?,
                    own: all(false)?,
                })
            })
            .collect::<Result<_>>()?;
        Ok(Self {
            names: contexts.iter().map(|context| context.name()).collect(),
            batch,
            layers,
        })
    }

    /// Whether these are the contexts.
    pub(super) fn is_of(&self, contexts: &[&FrameContext], batch: usize) -> bool {
        let names = contexts.iter().map(|context| context.name());
        self.batch == batch && names.eq(self.names.iter().copied())
    }

    /// Whether it is of the same frames.
    pub(super) fn is(&self, other: &Self) -> bool {
        self.batch == other.batch && self.names == other.names
    }

    /// How many frames.
    pub(super) fn frames(&self) -> usize {
        self.names.len()
    }

    pub(super) fn layers(&self) -> &[EarlierLayer] {
        &self.layers
    }

    pub(super) fn counts(&self) -> Result<Counts> {
        let Some(layer) = self.layers.first() else {
            return Ok((0, 0));
        };
        let count = |part: &Option<KeysValues>| part.as_ref().map_or(Ok(0), KeysValues::frames);
        Ok((count(&layer.shared)?, count(&layer.own)?))
    }

    /// In memory of its own.
    pub(super) fn copied(&self) -> Result<Self> {
        let copied = |part: &Option<KeysValues>| part.as_ref().map(KeysValues::copied).transpose();
        let layers = self.layers.iter().map(|layer| {
            Ok(EarlierLayer {
                shared: copied(&layer.shared)?,
                own: copied(&layer.own)?,
            })
        });
        Ok(Self {
            layers: layers.collect::<Result<_>>()?,
            ..self.clone()
        })
    }

    /// Becomes `other`, of as many frames, in the memory that it has.
    pub(super) fn overwrite(&mut self, other: &Self) -> Result<()> {
        for (layer, other) in self.layers.iter().zip(&other.layers) {
            let pairs = [(&layer.shared, &other.shared), (&layer.own, &other.own)];
            for (old, new) in pairs {
                if let (Some(old), Some(new)) = (old, new) {
                    old.overwrite(new)?;
                }
            }
        }
        self.names.clone_from(&other.names);
        Ok(())
    }
}

/// Keys and values of all `contexts` in one block.
fn side_by_side<'a>(
    contexts: impl Iterator<Item = &'a FrameContext>,
    layer: usize,
) -> Result<Option<KeysValues>> {
    let (mut keys, mut values) = (Vec::new(), Vec::new());
    for context in contexts {
        if let Some(kept) = context.kept.layers.get(layer) {
            keys.push(kept.keys.narrow(FRAMES, context.index, 1)?);
            values.push(kept.values.narrow(FRAMES, context.index, 1)?);
        }
    }
    if keys.is_empty() {
        return Ok(None);
    }
    Ok(Some(KeysValues {
        keys: Tensor::cat(&keys, FRAMES)?.contiguous()?,
        values: Tensor::cat(&values, FRAMES)?.contiguous()?,
    }))
}
