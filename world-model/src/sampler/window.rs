//! The frames that the next prediction sees, and what is already computed of them.

use std::collections::VecDeque;

use candle_core::{DType, Device, Tensor};

use super::{expand, require_finite};
use crate::transition::{ActionAlignment, FrameContext, Transition};
use crate::{Error, Result};

/// Frames in order, the actions between them, and the contexts of the first so many of them.
///
/// Frames and actions have a batch of 1, or of the number of candidates.
#[derive(Clone, Debug)]
pub(super) struct Window {
    /// (B, H, W, C) each.
    frames: VecDeque<Tensor>,
    /// (B, A) each; number i leads from frame i to the next.
    actions: VecDeque<Tensor>,
    /// Of frames 0, 1, ..; those not computed yet are missing at the end.
    contexts: Vec<FrameContext>,
    /// Noise level that the frames are said to have.
    tau: f64,
}

impl Window {
    pub(super) fn new(
        model: &Transition,
        context: &Tensor,
        actions: Option<&Tensor>,
        tau: f64,
    ) -> Result<Self> {
        let c = model.config();
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
            tau,
        };
        for i in first..t {
            let frame = context.narrow(1, i, 1)?.squeeze(1)?;
            require_finite("the context", &frame)?;
            window.frames.push_back(frame.contiguous()?);
        }
        if let Some(actions) = actions {
            for i in first..t - 1 {
                let action = actions.narrow(0, i, 1)?;
                require_finite("the actions of the context", &action)?;
                window.actions.push_back(action);
            }
        }
        Ok(window)
    }

    /// Adds the action that leads from the last frame to the one to be predicted.
    pub(super) fn push_action(&mut self, action: Tensor) {
        self.actions.push_back(action);
    }

    /// Adds the frame that the last action led to.
    pub(super) fn push_frame(&mut self, frame: Tensor) {
        self.frames.push_back(frame);
    }

    /// Drops the oldest frames where there is no place for a new one. Positions start anew at the
    /// first frame, so nothing that was computed stays valid then.
    pub(super) fn make_room(&mut self, model: &Transition) {
        while self.frames.len() >= model.config().max_frames {
            self.frames.pop_front();
            self.actions.pop_front();
            self.contexts.clear();
        }
    }

    /// Computes the contexts of all frames whose action is known.
    pub(super) fn prepare(&mut self, model: &Transition) -> Result<()> {
        while let Some(frame) = self.frames.get(self.contexts.len()) {
            let Some(action) = self.action_fed_with(self.contexts.len(), model)? else {
                break;
            };
            let batch = frame.dim(0)?.max(action.dim(0)?);
            let batch = self
                .contexts
                .last()
                .map_or(batch, |context| batch.max(context.batch()));
            let x = expand(frame, batch)?.unsqueeze(1)?;
            let action = expand(&action, batch)?.unsqueeze(1)?;
            let tau = Tensor::full(self.tau as f32, (batch, 1), &Device::Cpu)?;
            let earlier = self.contexts();
            let (_, own) = model.output_after(&earlier, &x, &tau, &action)?;
            self.contexts.push(own);
        }
        Ok(())
    }

    /// The contexts computed so far.
    pub(super) fn contexts(&self) -> Vec<&FrameContext> {
        self.contexts.iter().collect()
    }

    pub(super) fn last_frame(&self) -> Result<Tensor> {
        self.frames.back().cloned().ok_or_else(|| Error::Shape {
            what: "the context",
            expected: "at least one frame".into(),
            found: vec![0],
        })
    }

    /// What is fed with the frame to be predicted, whose action was pushed last.
    pub(super) fn action_of_new_frame(&self, model: &Transition) -> Result<Tensor> {
        match (model.config().action_alignment, self.actions.back()) {
            (ActionAlignment::WithResult, Some(action)) => Ok(action.clone()),
            _ => no_action(model),
        }
    }

    /// What is fed with frame `i`, if it is known by now.
    fn action_fed_with(&self, i: usize, model: &Transition) -> Result<Option<Tensor>> {
        match model.config().action_alignment {
            ActionAlignment::WithFrame => Ok(self.actions.get(i).cloned()),
            ActionAlignment::WithResult => match i.checked_sub(1) {
                None => no_action(model).map(Some),
                Some(before) => Ok(self.actions.get(before).cloned()),
            },
        }
    }
}

/// Zeros, (1, A).
fn no_action(model: &Transition) -> Result<Tensor> {
    Ok(Tensor::zeros(
        (1, model.config().action_dim),
        DType::F32,
        &Device::Cpu,
    )?)
}
