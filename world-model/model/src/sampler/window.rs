//! The frames that the next prediction sees, and what is already computed of them.

use std::collections::VecDeque;

use candle_core::Tensor;

use crate::transition::{ActionAlignment, Batched, FrameContext, LoadedTransition, Modulation};
use crate::{Error, Result};

/// Euler steps whose modulation is computed together at most: it is larger than a frame's latent.
const STEPS_TOGETHER: usize = 16;

/// Frames that are computed together at most: more would only make the working set larger.
const TOGETHER: usize = 3;

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
        model: &LoadedTransition,
        context: &Tensor,
        actions: Option<&Tensor>,
        tau: f64,
    ) -> Result<Self> {
        let c = model.config();
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
                .push_back(model.hold_finite("the context", &frame)?);
        }
        if let Some(actions) = actions {
            for i in first..t - 1 {
                let action = actions.narrow(1, i, 1)?.squeeze(1)?;
                let action = model.hold_finite("the actions of the context", &action)?;
                window.actions.push_back(action);
            }
        }
        Ok(window)
    }

    /// Takes the contexts that `other` has of the same frames under the same actions; how many.
    pub(super) fn take_over(&mut self, other: &Self, model: &LoadedTransition) -> usize {
        if self.tau.to_bits() != other.tau.to_bits() {
            return 0;
        }
        let is_same = |i: usize| -> Option<bool> {
            let frames = (self.frames.get(i)?, other.frames.get(i)?);
            let action = |of: &Self| of.action_fed_with(i, model).ok()?;
            let actions = (action(self)?, action(other)?);
            // What cannot be compared is computed.
            let same = frames.0.is_same(frames.1).ok()?;
            Some(same && actions.0.is_same(&actions.1).ok()?)
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
    pub(super) fn prepare(&mut self, model: &LoadedTransition) -> Result<()> {
        self.prepare_but(model, 0)
    }

    /// Computes contexts until at most `rest` are missing, [`TOGETHER`] frames a pass.
    fn prepare_but(&mut self, model: &LoadedTransition, rest: usize) -> Result<()> {
        loop {
            let mut pending = self.pending(model)?;
            if pending.len() <= rest {
                return Ok(());
            }
            pending.truncate(TOGETHER);
            let mut passes = Passes::new(self, model, pending, &[], None)?;
            passes.contexts_only()?;
        }
    }

    /// The passes that give the network's output at a new frame for each of the Euler steps' noise levels (B), all with
    /// one action (B, A). Contexts that are still missing are computed in the first of them.
    pub(super) fn passes<'w>(
        &'w mut self,
        model: &'w LoadedTransition,
        taus: &'w [Vec<f32>],
        action: &'w Batched,
    ) -> Result<Passes<'w>> {
        self.prepare_but(model, TOGETHER - 1)?;
        let pending = self.pending(model)?;
        Passes::new(self, model, pending, taus, Some(action))
    }

    /// The frames whose contexts are missing and can be computed, with what is fed with each.
    fn pending(&self, model: &LoadedTransition) -> Result<Vec<(Batched, Batched)>> {
        let first = self.contexts.len();
        (first..)
            .zip(self.frames.iter().skip(first))
            .map_while(|(i, frame)| {
                let action = self.action_fed_with(i, model).transpose()?;
                Some(action.map(|action| (frame.clone(), action)))
            })
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
        if let Some(several) = of_all.find(|each| each.batch() != 1) {
            let reason = format!("the frames of {} were asked for", several.batch());
            return Err(Error::config("candidates", reason));
        }
        let values = |all: &VecDeque<Batched>| -> Result<Vec<f32>> {
            let each = all.iter().map(Batched::to_vec);
            Ok(each.collect::<Result<Vec<_>>>()?.concat())
        };
        Ok((values(&self.frames)?, values(&self.actions)?))
    }

    /// What is fed with the frame to be predicted, to which the action that was pushed last leads; `own` is the one that
    /// leads on from it, if it is known. Otherwise the last one goes on: no frame that a model was trained on had none.
    pub(super) fn action_of_new_frame(
        &self,
        model: &LoadedTransition,
        own: Option<Batched>,
    ) -> Result<Batched> {
        let alignment = model.config().action_alignment;
        let own = own.filter(|_| alignment == ActionAlignment::WithFrame);
        let known = own.or_else(|| self.actions.back().cloned());
        known.map_or_else(|| no_action(model), Ok)
    }

    /// What is fed with frame `i`, if it is known by now.
    fn action_fed_with(&self, i: usize, model: &LoadedTransition) -> Result<Option<Batched>> {
        Ok(match model.config().action_alignment {
            ActionAlignment::WithFrame => self.actions.get(i).cloned(),
            ActionAlignment::WithResult => match i.checked_sub(1) {
                None => Some(no_action(model)?),
                Some(before) => self.actions.get(before).cloned(),
            },
        })
    }
}

/// Zeros, (1, A).
fn no_action(model: &LoadedTransition) -> Result<Batched> {
    model.hold("no action", 1, vec![0.0; model.config().action_dim])
}

/// Passes that share what modulates their layers.
pub(super) struct Passes<'w> {
    window: &'w mut Window,
    model: &'w LoadedTransition,
    modulation: Modulation,
    /// Latents of the frames whose contexts are missing; theirs are the first entries of the modulation.
    pending: Vec<Batched>,
    /// Entry of the next Euler step.
    entry: usize,
    /// Noise levels of the Euler steps that the modulation does not have yet.
    taus: &'w [Vec<f32>],
    /// What is fed with the new frame; none where there is none.
    action: Option<&'w Batched>,
}

impl<'w> Passes<'w> {
    fn new(
        window: &'w mut Window,
        model: &'w LoadedTransition,
        pending: Vec<(Batched, Batched)>,
        taus: &'w [Vec<f32>],
        action: Option<&'w Batched>,
    ) -> Result<Self> {
        let batch = pending
            .iter()
            .flat_map(|(x, action)| [x.batch(), action.batch()])
            .chain(window.contexts.iter().map(FrameContext::batch))
            .chain(taus.iter().map(Vec::len))
            .fold(1, usize::max);
        let tau = vec![window.tau; batch];
        let actions = pending.iter().map(|(_, action)| action.expanded(batch));
        let actions = actions.collect::<Result<Vec<_>>>()?;
        let mut entries: Vec<(&[f32], &Batched)> = actions
            .iter()
            .map(|action| (tau.as_slice(), action))
            .collect();
        let (now, later) = taus.split_at(taus.len().min(STEPS_TOGETHER));
        entries.extend(steps(now, action));
        let latents = pending.iter().map(|(x, _)| x.expanded(batch));
        Ok(Self {
            modulation: model.modulate(&entries)?,
            entry: pending.len(),
            pending: latents.collect::<Result<_>>()?,
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
    pub(super) fn next(&mut self, x: &Batched) -> Result<Batched> {
        if self.entry == self.modulation.entries() {
            let (now, later) = self.taus.split_at(self.taus.len().min(STEPS_TOGETHER));
            let steps: Vec<_> = steps(now, self.action).collect();
            self.modulation = self.model.modulate(&steps)?;
            (self.entry, self.taus) = (0, later);
        }
        self.pass(Some(x))?
            .ok_or_else(|| Error::config("steps", "no frame was computed"))
    }

    fn pass(&mut self, x: Option<&Batched>) -> Result<Option<Batched>> {
        let pending = std::mem::take(&mut self.pending);
        let mut frames: Vec<(&Batched, usize)> =
            pending.iter().enumerate().map(|(i, x)| (x, i)).collect();
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

/// The entries of Euler steps at these noise levels, which all have one action.
fn steps<'a>(
    taus: &'a [Vec<f32>],
    action: Option<&'a Batched>,
) -> impl Iterator<Item = (&'a [f32], &'a Batched)> {
    let entry = move |tau: &'a Vec<f32>| Some((tau.as_slice(), action?));
    taus.iter().filter_map(entry)
}
