//! The frames that the next prediction sees, and what is already computed of them.

use std::collections::VecDeque;
use std::sync::Arc;

use candle_core::Tensor;

use crate::transition::{
    ActionAlignment, FrameContext, Modulation, PackedTransition, TransitionConfig,
};
use crate::{Error, Result};

/// Euler steps whose modulation is computed together at most: it is larger than a frame's latent.
const STEPS_TOGETHER: usize = 16;

/// Frames that are computed together at most: more would only make the working set larger.
const TOGETHER: usize = 3;

/// Values for a batch of candidates, or for a batch of 1, which all of them share. Clones share
/// the values.
#[derive(Clone, Debug, PartialEq)]
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
    /// Observed latents `context` (B, T, H, W, C) and the `actions` (B, T - 1, A) between them.
    pub(super) fn new(
        c: &TransitionConfig,
        context: &Tensor,
        actions: Option<&Tensor>,
        tau: f64,
    ) -> Result<Self> {
        let grid = [c.latent_height, c.latent_width, c.channels];
        let (b, t) = match context.dims() {
            [b, t, rest @ ..] if *b > 0 && *t > 0 && rest == grid => (*b, *t),
            _ => {
                return Err(Error::Shape {
                    what: "the context",
                    expected: format!("(B, T, {}, {}, {}), T >= 1", grid[0], grid[1], grid[2]),
                    found: context.dims().to_vec(),
                });
            }
        };
        let found = actions.map_or(vec![b, 0, c.action_dim], |a| a.dims().to_vec());
        if found != [b, t - 1, c.action_dim] {
            return Err(Error::Shape {
                what: "the actions of the context",
                expected: format!("({b}, {}, {})", t - 1, c.action_dim),
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
                let action = actions.narrow(1, i, 1)?.squeeze(1)?;
                let action = Batched::read("the actions of the context", &action)?;
                window.actions.push_back(action);
            }
        }
        Ok(window)
    }

    /// Takes the contexts that `other` has of the same frames under the same actions; how many.
    pub(super) fn take_over(&mut self, other: &Self, c: &TransitionConfig) -> usize {
        if self.tau.to_bits() != other.tau.to_bits() {
            return 0;
        }
        let is_same = |i: usize| -> Option<bool> {
            let frames = (self.frames.get(i)?, other.frames.get(i)?);
            let actions = (self.action_fed_with(i, c)?, other.action_fed_with(i, c)?);
            Some(frames.0 == frames.1 && actions.0 == actions.1)
        };
        let first = self.contexts.len();
        let contexts = (first..).zip(other.contexts.iter().skip(first));
        let same = contexts.take_while(|(i, _)| is_same(*i) == Some(true));
        let same: Vec<_> = same.map(|(_, context)| context.clone()).collect();
        let taken = same.len();
        self.contexts.extend(same);
        taken
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
        self.prepare_but(model, 0)
    }

    /// Computes contexts until at most `rest` are missing, [`TOGETHER`] frames a pass.
    fn prepare_but(&mut self, model: &PackedTransition, rest: usize) -> Result<()> {
        loop {
            let mut pending = self.pending(model.config());
            if pending.len() <= rest {
                return Ok(());
            }
            pending.truncate(TOGETHER);
            let mut passes = Passes::new(self, model, pending, &[], &[])?;
            passes.contexts_only()?;
        }
    }

    /// The passes that give the network's output at a new frame for each of the Euler steps' noise levels (B), all with
    /// one action (B, A). Contexts that are still missing are computed in the first of them.
    pub(super) fn passes<'w>(
        &'w mut self,
        model: &'w PackedTransition,
        taus: &'w [Vec<f32>],
        action: &'w [f32],
    ) -> Result<Passes<'w>> {
        self.prepare_but(model, TOGETHER - 1)?;
        let pending = self.pending(model.config());
        Passes::new(self, model, pending, taus, action)
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

    /// Values of all frames, and of the actions between them, where one candidate has them.
    pub(super) fn values(&self) -> Result<(Vec<f32>, Vec<f32>)> {
        let mut of_all = self.frames.iter().chain(&self.actions);
        if let Some(several) = of_all.find(|each| each.batch != 1) {
            let reason = format!("the frames of {} were asked for", several.batch);
            return Err(Error::config("candidates", reason));
        }
        let values = |all: &VecDeque<Batched>| {
            let each = all.iter().flat_map(|each| each.values.iter().copied());
            each.collect()
        };
        Ok((values(&self.frames), values(&self.actions)))
    }

    /// What is fed with the frame to be predicted, to which the action that was pushed last leads; `own` is the one that
    /// leads on from it, if it is known. Otherwise the last one goes on: no frame that a model was trained on had none.
    pub(super) fn action_of_new_frame(
        &self,
        c: &TransitionConfig,
        own: Option<Batched>,
    ) -> Batched {
        let own = own.filter(|_| c.action_alignment == ActionAlignment::WithFrame);
        own.or_else(|| self.actions.back().cloned())
            .unwrap_or_else(|| no_action(c))
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

/// Passes that share what modulates their layers.
pub(super) struct Passes<'w> {
    window: &'w mut Window,
    model: &'w PackedTransition,
    modulation: Modulation,
    /// Latents of the frames whose contexts are missing; theirs are the first entries of the modulation.
    pending: Vec<Arc<[f32]>>,
    /// Entry of the next Euler step.
    entry: usize,
    /// Noise levels of the Euler steps that the modulation does not have yet.
    taus: &'w [Vec<f32>],
    action: &'w [f32],
}

impl<'w> Passes<'w> {
    fn new(
        window: &'w mut Window,
        model: &'w PackedTransition,
        pending: Vec<(Batched, Batched)>,
        taus: &'w [Vec<f32>],
        action: &'w [f32],
    ) -> Result<Self> {
        let batch = pending
            .iter()
            .flat_map(|(x, action)| [x.batch, action.batch])
            .chain(window.contexts.iter().map(FrameContext::batch))
            .chain(taus.iter().map(Vec::len))
            .fold(1, usize::max);
        let tau = vec![window.tau; batch];
        let actions: Vec<_> = pending.iter().map(|(_, a)| a.expanded(batch)).collect();
        let mut entries: Vec<(&[f32], &[f32])> = actions
            .iter()
            .map(|action| (tau.as_slice(), &**action))
            .collect();
        let (now, later) = taus.split_at(taus.len().min(STEPS_TOGETHER));
        entries.extend(now.iter().map(|tau| (tau.as_slice(), action)));
        Ok(Self {
            modulation: model.modulate(&entries)?,
            entry: pending.len(),
            pending: pending.iter().map(|(x, _)| x.expanded(batch)).collect(),
            window,
            model,
            taus: later,
            action,
        })
    }

    /// The contexts that are missing, alone.
    fn contexts_only(&mut self) -> Result<()> {
        self.pass(None).map(drop)
    }

    /// The network's output at the new frame `x` (B, H, W, C) in the next Euler step.
    pub(super) fn next(&mut self, x: &[f32]) -> Result<Vec<f32>> {
        if self.entry == self.modulation.entries() {
            let (now, later) = self.taus.split_at(self.taus.len().min(STEPS_TOGETHER));
            let steps: Vec<_> = now
                .iter()
                .map(|tau| (tau.as_slice(), self.action))
                .collect();
            self.modulation = self.model.modulate(&steps)?;
            (self.entry, self.taus) = (0, later);
        }
        self.pass(Some(x))?
            .ok_or_else(|| Error::config("steps", "no frame was computed"))
    }

    fn pass(&mut self, x: Option<&[f32]>) -> Result<Option<Vec<f32>>> {
        let pending = std::mem::take(&mut self.pending);
        let mut frames: Vec<(&[f32], usize)> =
            pending.iter().enumerate().map(|(i, x)| (&**x, i)).collect();
        frames.extend(x.map(|x| (x, self.entry)));
        self.entry += 1;
        let earlier: Vec<&FrameContext> = self.window.contexts.iter().collect();
        let keep = pending.len();
        let mut output =
            self.model
                .pass_modulated(&earlier, &frames, &self.modulation, keep, keep)?;
        self.window.contexts.append(&mut output.contexts);
        Ok(output.outputs.pop())
    }
}
