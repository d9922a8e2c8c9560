//! The frames that the next prediction sees, and what is already computed of them.

use std::collections::VecDeque;
use std::sync::Arc;

use candle_core::Tensor;

use crate::transition::{
    ActionAlignment, FrameContext, NewFrame, PackedTransition, TransitionConfig,
};
use crate::{Error, Result};

/// Frames that are computed together at most: more would only make the working set larger.
const TOGETHER: usize = 3;

/// Values for a batch of candidates, or for a batch of 1, which all of them share. Clones share
/// the values.
#[derive(Clone, Debug)]
pub(super) struct Batched {
    pub(super) batch: usize,
    /// (batch, ..).
    pub(super) values: Arc<[f32]>,
}

impl Batched {
    /// The values of `tensor` (batch, ..), which must be finite.
    pub(super) fn read(what: &'static str, tensor: &Tensor) -> Result<Self> {
        let values: Vec<f32> = tensor.flatten_all()?.to_vec1()?;
        if values.iter().all(|v| v.is_finite()) {
            Ok(Self {
                batch: tensor.dim(0)?,
                values: values.into(),
            })
        } else {
            Err(Error::NotFinite { what })
        }
    }

    /// The values for a batch of `n`.
    pub(super) fn expanded(&self, n: usize) -> Arc<[f32]> {
        if self.batch == n {
            return self.values.clone();
        }
        self.values.repeat(n).into()
    }
}

/// Frames in order, the actions between them, and the contexts of the first so many of them.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// (B, H, W, C) each.
    frames: VecDeque<Batched>,
    /// (B, A) each; number i leads from frame i to the next.
    actions: VecDeque<Batched>,
    /// Of frames 0, 1, ..; those not computed yet are missing at the end.
    contexts: Vec<FrameContext>,
    /// Noise level that the frames are said to have.
    tau: f32,
}

impl Window {
    pub(super) fn new(
        c: &TransitionConfig,
        context: &Tensor,
        actions: Option<&Tensor>,
        tau: f64,
    ) -> Result<Self> {
        let grid = [c.latent_height, c.latent_width, c.channels];
        let t = match context.dims() {
            [1, t, rest @ ..] if *t > 0 && rest == grid => *t,
            _ => {
                return Err(Error::Shape {
                    what: "the context",
                    expected: format!("(1, T, {}, {}, {}), T >= 1", grid[0], grid[1], grid[2]),
                    found: context.dims().to_vec(),
                });
            }
        };
        let found = actions.map_or(vec![0, c.action_dim], |a| a.dims().to_vec());
        if found != [t - 1, c.action_dim] {
            return Err(Error::Shape {
                what: "the actions of the context",
                expected: format!("({}, {})", t - 1, c.action_dim),
                found,
            });
        }
        let first = t.saturating_sub(c.max_frames - 1);
        let mut window = Self {
            frames: VecDeque::new(),
            actions: VecDeque::new(),
            contexts: Vec::new(),
            tau: tau as f32,
        };
        for i in first..t {
            let frame = context.narrow(1, i, 1)?.squeeze(1)?;
            window
                .frames
                .push_back(Batched::read("the context", &frame)?);
        }
        if let Some(actions) = actions {
            for i in first..t - 1 {
                let action = actions.narrow(0, i, 1)?;
                let action = Batched::read("the actions of the context", &action)?;
                window.actions.push_back(action);
            }
        }
        Ok(window)
    }

    /// Adds the action that leads from the last frame to the one to be predicted.
    pub(super) fn push_action(&mut self, action: Batched) {
        self.actions.push_back(action);
    }

    /// Adds the frame that the last action led to.
    pub(super) fn push_frame(&mut self, frame: Batched) {
        self.frames.push_back(frame);
    }

    /// Drops the oldest frames where there is no place for a new one among `max_frames`. Positions
    /// start anew at the first frame, so nothing that was computed stays valid then.
    pub(super) fn make_room(&mut self, max_frames: usize) {
        while self.frames.len() >= max_frames {
            self.frames.pop_front();
            self.actions.pop_front();
            self.contexts.clear();
        }
    }

    /// Computes the contexts of all frames whose action is known.
    pub(super) fn prepare(&mut self, model: &PackedTransition) -> Result<()> {
        self.compute(model, 0, None).map(drop)
    }

    /// The network's output at `frame`, which follows all others. Contexts that are still missing
    /// are computed in the same pass.
    pub(super) fn output_at(
        &mut self,
        model: &PackedTransition,
        frame: NewFrame<'_>,
    ) -> Result<Vec<f32>> {
        // The last pass has a place for the new frame.
        self.compute(model, 1, Some(frame))?
            .ok_or_else(|| Error::config("max_frames", "no frame could be computed"))
    }

    /// Computes missing contexts, [`TOGETHER`] frames a pass, of which the last one leaves so many
    /// places for `frame`.
    fn compute(
        &mut self,
        model: &PackedTransition,
        places: usize,
        frame: Option<NewFrame<'_>>,
    ) -> Result<Option<Vec<f32>>> {
        loop {
            let pending = self.pending(model.config());
            let now = pending.len().min(TOGETHER - places.min(TOGETHER - 1));
            let is_last = now == pending.len();
            let frame = frame.filter(|_| is_last);
            if now == 0 && frame.is_none() {
                return Ok(None);
            }
            let pending = pending.get(..now).unwrap_or_default();
            let batch = frame.map_or(1, |frame| frame.tau.len());
            let batch = pending
                .iter()
                .flat_map(|(x, action)| [x.batch, action.batch])
                .chain(self.contexts.iter().map(FrameContext::batch))
                .fold(batch, usize::max);
            let tau = vec![self.tau; batch];
            let expanded: Vec<_> = pending
                .iter()
                .map(|(x, action)| (x.expanded(batch), action.expanded(batch)))
                .collect();
            let mut frames: Vec<NewFrame<'_>> = expanded
                .iter()
                .map(|(latents, action)| NewFrame {
                    latents,
                    tau: &tau,
                    action,
                })
                .collect();
            frames.extend(frame);
            let earlier: Vec<&FrameContext> = self.contexts.iter().collect();
            let mut pass = model.pass(&earlier, &frames, now, now)?;
            self.contexts.append(&mut pass.contexts);
            if is_last {
                return Ok(pass.outputs.pop());
            }
        }
    }

    /// The frames whose contexts are missing and can be computed, with what is fed with each.
    fn pending(&self, c: &TransitionConfig) -> Vec<(Batched, Batched)> {
        let first = self.contexts.len();
        (first..)
            .zip(self.frames.iter().skip(first))
            .map_while(|(i, frame)| Some((frame.clone(), self.action_fed_with(i, c)?)))
            .collect()
    }

    pub(super) fn last_frame(&self) -> Result<Batched> {
        self.frames.back().cloned().ok_or_else(|| Error::Shape {
            what: "the context",
            expected: "at least one frame".into(),
            found: vec![0],
        })
    }

    /// What is fed with the frame to be predicted, whose action was pushed last; `own` is the one
    /// that leads on from it, if it is known.
    pub(super) fn action_of_new_frame(
        &self,
        c: &TransitionConfig,
        own: Option<Batched>,
    ) -> Batched {
        let fed = match c.action_alignment {
            ActionAlignment::WithResult => self.actions.back().cloned(),
            ActionAlignment::WithFrame => own,
        };
        fed.unwrap_or_else(|| no_action(c))
    }

    /// What is fed with frame `i`, if it is known by now.
    fn action_fed_with(&self, i: usize, c: &TransitionConfig) -> Option<Batched> {
        match c.action_alignment {
            ActionAlignment::WithFrame => self.actions.get(i).cloned(),
            ActionAlignment::WithResult => match i.checked_sub(1) {
                None => Some(no_action(c)),
                Some(before) => self.actions.get(before).cloned(),
            },
        }
    }
}

/// Zeros, (1, A).
fn no_action(c: &TransitionConfig) -> Batched {
    Batched {
        batch: 1,
        values: vec![0.0; c.action_dim].into(),
    }
}
