//! Networks of tokens on kernels of the CPU, with packed weights.

use std::marker::PhantomData;
use std::ops::Deref;

use super::{HeadLayers, TokenLayers};
use crate::Result;
use crate::ops::activation::silu_chunk;
use crate::ops::buffer::Buffer;
use crate::ops::{PackedLinear, gated_residual, rms_norm_modulate, swiglu};

/// Kernels of the CPU, on the calling thread. `'a` is the life of the rows that they share with others.
#[derive(Clone, Copy, Default)]
pub(crate) struct PackedLayers<'a>(PhantomData<&'a ()>);

/// Rows of numbers. Those of the frames follow each other, and so do the modulations of the frames.
pub(crate) struct Rows<'a> {
    /// Numbers of a row.
    width: usize,
    numbers: Numbers<'a>,
}

enum Numbers<'a> {
    Own(Buffer),
    Shared(&'a [f32]),
    /// What computes the rows writes there.
    InPlace(&'a mut [f32]),
}

impl<'a> Rows<'a> {
    /// Rows of `width` numbers in a buffer.
    pub(crate) fn own(width: usize, numbers: Buffer) -> Self {
        let numbers = Numbers::Own(numbers);
        Self { width, numbers }
    }

    /// Rows of `width` numbers that stay as they are.
    pub(crate) fn shared(width: usize, numbers: &'a [f32]) -> Self {
        let numbers = Numbers::Shared(numbers);
        Self { width, numbers }
    }

    /// Rows of `width` numbers, which a result of as many replaces.
    pub(crate) fn in_place(width: usize, numbers: &'a mut [f32]) -> Self {
        let numbers = Numbers::InPlace(numbers);
        Self { width, numbers }
    }

    fn numbers_mut(&mut self) -> &mut [f32] {
        if let Numbers::Shared(numbers) = self.numbers {
            self.numbers = Numbers::Own(Buffer::copy_of(numbers));
        }
        match &mut self.numbers {
            Numbers::Own(buffer) => buffer,
            Numbers::InPlace(numbers) => numbers,
            Numbers::Shared(_) => &mut [],
        }
    }

    fn count(&self) -> usize {
        self.len() / self.width.max(1)
    }

    /// Numbers of a frame of these, whose frames have these modulations.
    fn frame(&self, modulation: &Rows<'_>) -> usize {
        (self.len() / modulation.count().max(1)).max(1)
    }

    /// Chunk `number` of every frame, for tokens of `d` channels.
    fn chunks(&self, number: usize, d: usize) -> impl Iterator<Item = &[f32]> {
        let frames = self.chunks_exact(self.width.max(1));
        frames.map(move |frame| &frame[number * d..][..d])
    }
}

impl Deref for Rows<'_> {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        match &self.numbers {
            Numbers::Own(buffer) => buffer,
            Numbers::Shared(numbers) => numbers,
            Numbers::InPlace(numbers) => numbers,
        }
    }
}

impl<'a> TokenLayers for PackedLayers<'a> {
    type Linear = PackedLinear;
    type Value = Rows<'a>;

    fn linear(&mut self, linear: &PackedLinear, x: &Rows<'a>) -> Result<Rows<'a>> {
        let mut y = Buffer::of(x.count() * linear.outputs());
        linear.forward(x, &mut y);
        Ok(Rows::own(linear.outputs(), y))
    }

    fn norm_modulate(
        &mut self,
        x: &Rows<'a>,
        modulation: &Rows<'a>,
        first: usize,
    ) -> Result<Rows<'a>> {
        let (frame, d) = (x.frame(modulation), x.width);
        let mut out = Buffer::of(x.len());
        let frames = x.chunks_exact(frame).zip(out.chunks_exact_mut(frame));
        let modulations = modulation
            .chunks(first, d)
            .zip(modulation.chunks(first + 1, d));
        for ((x, out), (shift, scale)) in frames.zip(modulations) {
            rms_norm_modulate::forward_frame(out, x, shift, scale);
        }
        Ok(Rows::own(d, out))
    }

    fn linear_swiglu(&mut self, linear: &PackedLinear, x: &Rows<'a>) -> Result<Rows<'a>> {
        let up = self.linear(linear, x)?;
        let hidden = up.width / 2;
        let mut out = Buffer::of(up.len() / 2);
        swiglu::forward_rows(&mut out, &up, hidden);
        Ok(Rows::own(hidden, out))
    }

    fn linear_gated(
        &mut self,
        linear: &PackedLinear,
        x: &Rows<'a>,
        mut residual: Rows<'a>,
        modulation: &Rows<'a>,
        gate: usize,
    ) -> Result<Rows<'a>> {
        let branch = self.linear(linear, x)?;
        let (frame, d) = (residual.frame(modulation), residual.width);
        let frames = residual.numbers_mut().chunks_exact_mut(frame);
        let frames = frames.zip(branch.chunks_exact(frame));
        for ((out, branch), gate) in frames.zip(modulation.chunks(gate, d)) {
            gated_residual::forward_frame(out, branch, gate);
        }
        Ok(residual)
    }
}

impl<'a> HeadLayers for PackedLayers<'a> {
    fn silu(&mut self, mut x: Rows<'a>) -> Result<Rows<'a>> {
        silu_chunk(x.numbers_mut());
        Ok(x)
    }

    fn sum(&mut self, mut x: Rows<'a>, y: &Rows<'a>) -> Result<Rows<'a>> {
        for (x, y) in x.numbers_mut().iter_mut().zip(y.iter()) {
            *x += y;
        }
        Ok(x)
    }

    fn add_to_frames(&mut self, x: &Rows<'a>, rows: &Rows<'a>) -> Result<Rows<'a>> {
        let (frame, d) = (x.frame(rows), x.width);
        let mut out = Buffer::copy_of(x);
        for (frame, row) in out.chunks_exact_mut(frame).zip(rows.chunks(0, d)) {
            for token in frame.chunks_exact_mut(d.max(1)) {
                for (x, y) in token.iter_mut().zip(row) {
                    *x += y;
                }
            }
        }
        Ok(Rows::own(d, out))
    }
}
