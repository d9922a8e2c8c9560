//! The two halves of a transformer block, on the rows of one task.

use super::source::NamedLayers;
use crate::Result;
use crate::ops::{PackedLinear, gated_residual, rms_norm_modulate, swiglu};

/// Parts of a sub-block's modulation: shift, scale and gate of the attention, then of the
/// feed-forward network.
const PARTS: usize = 6;

/// A spatial or a temporal sub-block.
#[derive(Debug)]
pub(super) struct SubBlock {
    pub(super) modulation: PackedLinear,
    qkv: PackedLinear,
    out: PackedLinear,
    up: PackedLinear,
    down: PackedLinear,
}

/// Buffers of a thread; they only ever grow.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) normed: Vec<f32>,
    pub(super) qkv: Vec<f32>,
    pub(super) attended: Vec<f32>,
    pub(super) scores: Vec<f32>,
    pub(super) queries: Vec<f32>,
    /// Keys and values of frames that later frames do not need.
    pub(super) keys: Vec<f32>,
    pub(super) values: Vec<f32>,
    up: Vec<f32>,
    gated: Vec<f32>,
}

impl SubBlock {
    /// That whose names start with `name`.
    pub(super) fn new(name: &str, layers: &NamedLayers<'_>) -> Result<Self> {
        let linear = |part: &str| layers.linear(&format!("{name}.{part}"));
        Ok(Self {
            // It meets every token of a frame.
            modulation: layers.sensitive(&format!("{name}.adaLN_modulation.1"))?,
            qkv: linear("attn.qkv_proj")?,
            out: linear("attn.out_proj")?,
            up: linear("ffwd.w12")?,
            down: linear("ffwd.w3")?,
        })
    }

    /// Queries, keys and values of `x` (rows, d), to `scratch.qkv` (rows, 3 d). Rows follow each
    /// other frame by frame, and so do the frames' `modulation`s (6 d each).
    pub(super) fn project(&self, x: &[f32], modulation: &[f32], scratch: &mut Scratch) {
        let normed = sized(&mut scratch.normed, x.len());
        self.normalise(x, modulation, [0, 1], normed);
        self.qkv
            .forward(normed, sized(&mut scratch.qkv, 3 * x.len()));
    }

    /// What follows the attention, whose result is in `scratch.attended`: adds to `x` (rows, d).
    pub(super) fn finish(&self, x: &mut [f32], modulation: &[f32], scratch: &mut Scratch) {
        let Scratch {
            normed,
            attended,
            up,
            gated,
            ..
        } = scratch;
        let branch = sized(normed, x.len());
        self.out.forward(sized(attended, x.len()), branch);
        self.add(x, branch, modulation, 2);
        self.normalise(x, modulation, [3, 4], branch);
        let rows = x.len() / self.out.outputs().max(1);
        let up = sized(up, rows * self.up.outputs());
        self.up.forward(branch, up);
        let gated = sized(gated, rows * self.down.inputs());
        swiglu::forward_rows(gated, up, self.down.inputs());
        self.down.forward(gated, branch);
        self.add(x, branch, modulation, 5);
    }

    fn normalise(
        &self,
        x: &[f32],
        modulation: &[f32],
        [shift, scale]: [usize; 2],
        out: &mut [f32],
    ) {
        let (d, frame) = self.frame(x.len(), modulation);
        let frames = x.chunks_exact(frame).zip(out.chunks_exact_mut(frame));
        for ((x, out), modulation) in frames.zip(modulation.chunks_exact(PARTS * d)) {
            if let (Some(shift), Some(scale)) =
                (part(modulation, d, shift), part(modulation, d, scale))
            {
                rms_norm_modulate::forward_frame(out, x, shift, scale);
            }
        }
    }

    fn add(&self, x: &mut [f32], branch: &[f32], modulation: &[f32], gate: usize) {
        let (d, frame) = self.frame(x.len(), modulation);
        let frames = x.chunks_exact_mut(frame).zip(branch.chunks_exact(frame));
        for ((x, branch), modulation) in frames.zip(modulation.chunks_exact(PARTS * d)) {
            if let Some(gate) = part(modulation, d, gate) {
                gated_residual::forward_frame(x, branch, gate);
            }
        }
    }

    /// Width of a token, and values of a frame's rows.
    fn frame(&self, values: usize, modulation: &[f32]) -> (usize, usize) {
        let d = self.qkv.inputs();
        let frames = modulation.len() / (PARTS * d).max(1);
        (d, (values / frames.max(1)).max(1))
    }
}

/// Part `i` of a frame's modulation.
pub(super) fn part(modulation: &[f32], d: usize, i: usize) -> Option<&[f32]> {
    modulation.get(i * d..(i + 1) * d)
}

/// The first `length` values of a buffer that is made longer if need be.
pub(super) fn sized(buffer: &mut Vec<f32>, length: usize) -> &mut [f32] {
    if buffer.len() < length {
        buffer.resize(length, 0.0);
    }
    buffer.get_mut(..length).unwrap_or_default()
}
