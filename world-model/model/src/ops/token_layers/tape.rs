//! Networks of tokens on kernels of the CPU, with their gradients.
//!
//! Candle's backward pass fills a tensor with zeros for each operand of each operation and adds the gradient to it, and
//! every result is a new tensor: for a model as small as the embedded default that is a quarter of a step. The tape
//! keeps what its backward pass needs in buffers that are used again, and adds in place.

use std::sync::Arc;

use super::weight_gradients::add;
use super::{ClipLayers, Linear, TokenLayers, WeightGradients};
use crate::Result;
use crate::ops::buffer::Buffer;
use crate::ops::{AttentionPattern, gated_residual, linear, rms_norm_modulate, swiglu};

/// The record of a forward pass. Values are numbers in it.
#[derive(Default)]
pub(crate) struct TokenTape {
    values: Vec<Value>,
}

/// Clips, frames of a clip, rows of a frame, and values of a row.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) clips: usize,
    pub(crate) frames: usize,
    pub(crate) rows: usize,
    pub(crate) width: usize,
}

impl Sizes {
    fn count(self) -> usize {
        self.clips * self.frames * self.rows * self.width
    }

    /// Values of a frame.
    fn frame(self) -> usize {
        self.rows * self.width
    }

    fn with_width(self, width: usize) -> Self {
        Self { width, ..self }
    }
}

struct Value {
    numbers: Buffer,
    sizes: Sizes,
    origin: Origin,
}

/// The operation that made a value.
enum Origin {
    Input,
    Linear {
        linear: Linear,
        x: usize,
    },
    NormModulate {
        x: usize,
        modulation: usize,
        first: usize,
    },
    LinearSwiglu {
        linear: Linear,
        x: usize,
        /// What the linear layer gave.
        up: Buffer,
    },
    LinearGated {
        linear: Linear,
        x: usize,
        residual: usize,
        modulation: usize,
        gate: usize,
        /// What the linear layer gave.
        branch: Buffer,
    },
    Attention {
        pattern: Arc<AttentionPattern>,
        qkv: usize,
    },
    LastFrames {
        x: usize,
    },
}

/// Gradients by values, by their numbers.
struct Gradients(Vec<Option<Buffer>>);

impl Gradients {
    /// Adds to the gradient by a value.
    fn add(&mut self, number: usize, gradient: Buffer) {
        match &mut self.0[number] {
            Some(sum) => add(sum, &gradient),
            empty => *empty = Some(gradient),
        }
    }

    /// The gradient by a value of so many numbers, zeros at first.
    fn or_zeros(&mut self, number: usize, length: usize) -> &mut Buffer {
        self.0[number].get_or_insert_with(|| Buffer::zeros(length))
    }
}

/// Chunk `number` of a frame's modulation.
fn chunk(modulation: &[f32], number: usize, width: usize) -> &[f32] {
    &modulation[number * width..][..width]
}

/// The last frames of each clip of `values`.
fn last_of(values: &[f32], all: Sizes, last: usize) -> impl Iterator<Item = &[f32]> {
    let clips = values.chunks_exact(all.frames * all.frame());
    clips.map(move |clip| &clip[(all.frames - last) * all.frame()..])
}

impl TokenTape {
    /// Forgets the record.
    pub(crate) fn clear(&mut self) {
        self.values.clear();
    }

    /// Records an input.
    pub(crate) fn input(&mut self, numbers: &[f32], sizes: Sizes) -> usize {
        self.push(Buffer::copy_of(numbers), sizes, Origin::Input)
    }

    /// The numbers of a value.
    pub(crate) fn numbers(&self, value: usize) -> &[f32] {
        &self.values[value].numbers
    }

    fn push(&mut self, numbers: Buffer, sizes: Sizes, origin: Origin) -> usize {
        debug_assert_eq!(
            numbers.len(),
            sizes.count(),
            "a value has the sizes that are recorded"
        );
        self.values.push(Value {
            numbers,
            sizes,
            origin,
        });
        self.values.len() - 1
    }

    fn of(&self, value: usize) -> (&[f32], Sizes) {
        let Value { numbers, sizes, .. } = &self.values[value];
        (numbers, *sizes)
    }

    /// The gradients by the `inputs`, for the gradient `g` by value `output`; those by weights go to `weights`.
    ///
    /// # Errors
    /// If a weight is not on the CPU.
    pub(crate) fn backward<const N: usize>(
        &self,
        output: usize,
        g: Buffer,
        weights: &WeightGradients,
        inputs: [usize; N],
    ) -> Result<[Buffer; N]> {
        let mut gradients = Gradients(Vec::new());
        gradients.0.resize_with(self.values.len(), || None);
        gradients.add(output, g);
        for (number, value) in self.values.iter().enumerate().rev() {
            if matches!(value.origin, Origin::Input) {
                continue;
            }
            if let Some(g) = gradients.0[number].take() {
                self.back(value, g, weights, &mut gradients)?;
            }
        }
        Ok(inputs.map(|input| {
            let gradient = gradients.0[input].take();
            gradient.unwrap_or_else(|| Buffer::zeros(self.numbers(input).len()))
        }))
    }

    /// Adds the gradients by the operands of the operation that made `value`, for the gradient `g` by it.
    fn back(
        &self,
        value: &Value,
        g: Buffer,
        weights: &WeightGradients,
        gradients: &mut Gradients,
    ) -> Result<()> {
        match &value.origin {
            Origin::Input => {}
            Origin::Linear { linear, x } => {
                let by_x = linear.back(self.numbers(*x), &g, weights)?;
                gradients.add(*x, by_x);
            }
            Origin::NormModulate {
                x,
                modulation,
                first,
            } => self.norm_back((*x, *modulation), *first, &g, gradients),
            Origin::LinearSwiglu { linear, x, up } => {
                let mut by_up = Buffer::of(up.len());
                swiglu::backward_rows(&mut by_up, up, &g, value.sizes.width);
                let by_x = linear.back(self.numbers(*x), &by_up, weights)?;
                gradients.add(*x, by_x);
            }
            Origin::LinearGated {
                linear,
                x,
                residual,
                modulation,
                gate,
                branch,
            } => {
                let by_branch = self.gate_back(branch, (*modulation, *gate), &g, value, gradients);
                let by_x = linear.back(self.numbers(*x), &by_branch, weights)?;
                gradients.add(*x, by_x);
                gradients.add(*residual, g);
            }
            Origin::Attention { pattern, qkv } => {
                let (numbers, sizes) = self.of(*qkv);
                let mut by_qkv = Buffer::of(numbers.len());
                pattern.backward(&shape(sizes), numbers, &g, &mut by_qkv)?;
                gradients.add(*qkv, by_qkv);
            }
            Origin::LastFrames { x } => {
                let (_, all) = self.of(*x);
                let mut by_x = Buffer::zeros(all.count());
                let kept = value.sizes.frames * all.frame();
                let clips = by_x.chunks_exact_mut(all.frames * all.frame());
                for (clip, g) in clips.zip(g.chunks_exact(kept)) {
                    let others = clip.len() - kept;
                    clip[others..].copy_from_slice(g);
                }
                gradients.add(*x, by_x);
            }
        }
        Ok(())
    }

    fn gate_back(
        &self,
        branch: &[f32],
        (modulation, gate): (usize, usize),
        g: &[f32],
        value: &Value,
        gradients: &mut Gradients,
    ) -> Buffer {
        let (modulations, of_frame) = self.of(modulation);
        let (frame, d) = (value.sizes.frame(), value.sizes.width);
        let by_modulation = gradients.or_zeros(modulation, modulations.len());
        let mut by_branch = Buffer::of(g.len());
        let frames = by_branch.chunks_exact_mut(frame);
        let frames = frames
            .zip(g.chunks_exact(frame))
            .zip(branch.chunks_exact(frame));
        let modulations = modulations.chunks_exact(of_frame.width);
        let modulations = modulations.zip(by_modulation.chunks_exact_mut(of_frame.width));
        for (((out, g), branch), (modulation, by_modulation)) in frames.zip(modulations) {
            let by_gate = &mut by_modulation[gate * d..][..d];
            gated_residual::backward_frame(out, by_gate, branch, g, chunk(modulation, gate, d));
        }
        by_branch
    }

    fn norm_back(
        &self,
        (x, modulation): (usize, usize),
        first: usize,
        g: &[f32],
        gradients: &mut Gradients,
    ) {
        let (x_numbers, sizes) = self.of(x);
        let (modulations, of_frame) = self.of(modulation);
        let (frame, d) = (sizes.frame(), sizes.width);
        // Out of the gradients, so that the modulation's can be written beside it.
        let mut by_x = gradients.0[x].take();
        let by_modulation = gradients.or_zeros(modulation, modulations.len());
        let by_x_sum = by_x.get_or_insert_with(|| Buffer::zeros(x_numbers.len()));
        let mut by_frame = Buffer::of(frame);
        let frames = by_x_sum.chunks_exact_mut(frame);
        let frames = frames
            .zip(g.chunks_exact(frame))
            .zip(x_numbers.chunks_exact(frame));
        let modulations = modulations.chunks_exact(of_frame.width);
        let modulations = modulations.zip(by_modulation.chunks_exact_mut(of_frame.width));
        for (((sum, g), x), (modulation, by_modulation)) in frames.zip(modulations) {
            let by_both = &mut by_modulation[first * d..][..2 * d];
            let (by_shift, by_scale) = by_both.split_at_mut(d);
            let scale = chunk(modulation, first + 1, d);
            rms_norm_modulate::backward_frame(&mut by_frame, x, g, scale, by_shift, by_scale);
            // The frame's gradient is still in cache.
            add(sum, &by_frame);
        }
        gradients.0[x] = by_x;
    }
}

fn shape(sizes: Sizes) -> candle_core::Shape {
    (sizes.clips, sizes.frames, sizes.rows, sizes.width).into()
}

impl TokenLayers for TokenTape {
    type Linear = Linear;
    type Value = usize;

    fn linear(&mut self, linear: &Linear, x: &usize) -> Result<usize> {
        let (numbers, sizes) = self.of(*x);
        let mut y = linear.product(numbers)?;
        if linear.bias.is_some() {
            linear::add_to_rows(&mut y, &linear.bias()?);
        }
        let sizes = sizes.with_width(linear.sizes()?.0);
        let linear = linear.clone();
        Ok(self.push(y, sizes, Origin::Linear { linear, x: *x }))
    }

    fn norm_modulate(&mut self, x: &usize, modulation: &usize, first: usize) -> Result<usize> {
        let (numbers, sizes) = self.of(*x);
        let (modulations, of_frame) = self.of(*modulation);
        let mut out = Buffer::of(numbers.len());
        let frames = out.chunks_exact_mut(sizes.frame());
        let frames = frames.zip(numbers.chunks_exact(sizes.frame()));
        for ((out, x), modulation) in frames.zip(modulations.chunks_exact(of_frame.width)) {
            let [shift, scale] = [first, first + 1].map(|n| chunk(modulation, n, sizes.width));
            rms_norm_modulate::forward_frame(out, x, shift, scale);
        }
        let origin = Origin::NormModulate {
            x: *x,
            modulation: *modulation,
            first,
        };
        Ok(self.push(out, sizes, origin))
    }

    fn linear_swiglu(&mut self, linear: &Linear, x: &usize) -> Result<usize> {
        let (numbers, sizes) = self.of(*x);
        let mut up = linear.product(numbers)?;
        let bias = linear.bias()?;
        let sizes = sizes.with_width(bias.len() / 2);
        let mut out = Buffer::of(sizes.count());
        let frames = out.chunks_exact_mut(sizes.frame());
        for (out, up) in frames.zip(up.chunks_exact_mut(2 * sizes.frame())) {
            // While it is in cache.
            linear::add_to_rows(up, &bias);
            swiglu::forward_rows(out, up, sizes.width);
        }
        let linear = linear.clone();
        Ok(self.push(out, sizes, Origin::LinearSwiglu { linear, x: *x, up }))
    }

    fn linear_gated(
        &mut self,
        linear: &Linear,
        x: &usize,
        residual: usize,
        modulation: &usize,
        gate: usize,
    ) -> Result<usize> {
        let mut branch = linear.product(self.numbers(*x))?;
        let bias = linear.bias()?;
        let (residuals, sizes) = self.of(residual);
        let (modulations, of_frame) = self.of(*modulation);
        let mut out = Buffer::of(residuals.len());
        let frames = out.chunks_exact_mut(sizes.frame());
        let frames = frames.zip(residuals.chunks_exact(sizes.frame()));
        let frames = frames.zip(branch.chunks_exact_mut(sizes.frame()));
        for (((out, residual), branch), modulation) in
            frames.zip(modulations.chunks_exact(of_frame.width))
        {
            // While it is in cache.
            linear::add_to_rows(branch, &bias);
            out.copy_from_slice(residual);
            gated_residual::forward_frame(out, branch, chunk(modulation, gate, sizes.width));
        }
        let origin = Origin::LinearGated {
            linear: linear.clone(),
            x: *x,
            residual,
            modulation: *modulation,
            gate,
            branch,
        };
        Ok(self.push(out, sizes, origin))
    }
}

impl ClipLayers for TokenTape {
    fn attention(&mut self, qkv: &usize, pattern: &Arc<AttentionPattern>) -> Result<usize> {
        let (numbers, sizes) = self.of(*qkv);
        let mut out = Buffer::of(numbers.len() / 3);
        pattern.forward(&shape(sizes), numbers, &mut out)?;
        let origin = Origin::Attention {
            pattern: Arc::clone(pattern),
            qkv: *qkv,
        };
        Ok(self.push(out, sizes.with_width(sizes.width / 3), origin))
    }

    fn last_frames(&mut self, x: usize, last: usize) -> Result<usize> {
        let (numbers, all) = self.of(x);
        if all.frames == last {
            return Ok(x);
        }
        let sizes = Sizes {
            frames: last,
            ..all
        };
        let mut out = Buffer::of(sizes.count());
        let kept = out.chunks_exact_mut(last * all.frame());
        for (out, kept) in kept.zip(last_of(numbers, all, last)) {
            out.copy_from_slice(kept);
        }
        Ok(self.push(out, sizes, Origin::LastFrames { x }))
    }
}
