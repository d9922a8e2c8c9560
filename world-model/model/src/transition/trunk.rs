//! All blocks as one operation, for training on the CPU.
//!
//! Candle's backward pass fills a tensor with zeros for each operand of each operation and adds the gradient to it, and
//! every result is a new tensor: for a model as small as the embedded default that is a quarter of a step. This operation
//! keeps what its backward pass needs in buffers that are used again, and adds in place. An operation of candle's has three
//! operands at most, so that gradients by weights go another way: [`WeightGradients`].

use std::{
    collections::{HashMap, hash_map::Entry},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use candle_core::{
    CpuStorage, CustomOp2, DType, Layout, Result, Shape, Tensor, TensorId, backprop::GradStore,
};

use super::block::{Block, SubBlock};
use super::parameters::Linear;
use crate::ops::buffer::Buffer;
use crate::ops::host::{host, slice};
use crate::ops::{AttentionPattern, gated_residual, linear, rms_norm_modulate, swiglu};

/// Chunks of a frame's modulation: shift, scale and gate of the attention, then of the feed-forward network.
const CHUNKS: usize = 6;

/// Gradients by weights that are no operands of candle's operations; see [`super::Transition::collecting`].
#[derive(Clone, Debug, Default)]
pub struct WeightGradients(Arc<Mutex<HashMap<TensorId, Vec<f32>>>>);

impl WeightGradients {
    /// The gradient by `weight`, with what candle's own backward pass left in `store`; `None` where neither has one. It is
    /// forgotten here.
    ///
    /// # Errors
    /// If that of `store` cannot be read.
    pub fn take(&self, weight: &Tensor, store: &GradStore) -> Result<Option<Vec<f32>>> {
        let collected = self.lock().remove(&weight.id());
        let Some(own) = store.get(weight) else {
            return Ok(collected);
        };
        let mut sum = own.flatten_all()?.to_dtype(DType::F32)?.to_vec1()?;
        add(&mut sum, &collected.unwrap_or_default());
        Ok(Some(sum))
    }

    /// Adds one of them.
    fn add(&self, weight: &Tensor, gradient: Vec<f32>) {
        match self.lock().entry(weight.id()) {
            Entry::Vacant(entry) => {
                entry.insert(gradient);
            }
            Entry::Occupied(mut sum) => add(sum.get_mut(), &gradient),
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<TensorId, Vec<f32>>> {
        // Whole entries are consistent whoever panicked.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn add(sum: &mut [f32], values: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += value;
    }
}

/// The tokens of the `last` frames of `tokens` (B, T, N, d) after all `blocks`, for frames whose modulations start from
/// `activated` (B T, d): (B, last, N, d).
///
/// # Errors
/// If the shapes do not fit.
pub(super) fn trunk(
    blocks: &[Block],
    patterns: [&Arc<AttentionPattern>; 2],
    gradients: &WeightGradients,
    (tokens, last): (&Tensor, usize),
    activated: &Tensor,
) -> Result<Tensor> {
    let [spatial, temporal] = patterns.map(Arc::clone);
    let parts = blocks.iter().flat_map(|block| {
        [
            (block.spatial.clone(), Arc::clone(&spatial)),
            (block.temporal.clone(), Arc::clone(&temporal)),
        ]
    });
    let op = Trunk {
        parts: parts.collect(),
        last,
        saved: Mutex::default(),
        gradients: gradients.clone(),
    };
    tokens.contiguous()?.apply_op2(&activated.contiguous()?, op)
}

struct Trunk {
    parts: Vec<(SubBlock, Arc<AttentionPattern>)>,
    /// Frames of each clip that are asked for. Behind the last attention, the others are of no use.
    last: usize,
    /// Of the forward pass, one for each part.
    saved: Mutex<Vec<Saved>>,
    gradients: WeightGradients,
}

/// What the backward pass of a sub-block needs.
struct Saved {
    /// (frames, 6 d).
    modulation: Buffer,
    attention: SavedBranch,
    qkv: Buffer,
    feed_forward: SavedBranch,
    up: Buffer,
}

/// One of the two residual branches.
struct SavedBranch {
    /// What the branch adds to, (rows, d).
    input: Buffer,
    /// The input normalised and modulated, (rows, d).
    normed: Buffer,
    /// What its last layer takes, (rows, width of the layer).
    inner: Buffer,
    /// What it adds, before the gate, (rows, d).
    output: Buffer,
}

/// The sizes of tokens.
#[derive(Clone, Copy)]
struct Sizes {
    b: usize,
    t: usize,
    n: usize,
    d: usize,
}

impl Sizes {
    fn new(tokens: &Shape, activated: &Shape) -> Result<Self> {
        let (b, t, n, d) = tokens.dims4()?;
        if activated.dims() != [b * t, d] || tokens.elem_count() == 0 {
            candle_core::bail!("blocks: tokens {tokens:?} with conditions {activated:?}");
        }
        Ok(Self { b, t, n, d })
    }

    fn rows(self) -> usize {
        self.b * self.t * self.n
    }

    /// Those of the last `t` frames of each clip.
    fn last(self, t: usize) -> Self {
        Self { t, ..self }
    }

    /// Values of a frame's tokens, and of its modulation.
    fn frame(self) -> usize {
        self.n * self.d
    }

    fn modulation(self) -> usize {
        CHUNKS * self.d
    }

    fn qkv(self) -> Shape {
        (self.b, self.t, self.n, 3 * self.d).into()
    }
}

/// Shift, scale and gate of a branch, for one frame.
fn chunks(modulation: &[f32], branch: usize, d: usize) -> [&[f32]; 3] {
    [0, 1, 2].map(|chunk| &modulation[(3 * branch + chunk) * d..][..d])
}

fn chunks_mut(modulation: &mut [f32], branch: usize, d: usize) -> [&mut [f32]; 3] {
    let (shift, rest) = modulation[3 * branch * d..][..3 * d].split_at_mut(d);
    let (scale, gate) = rest.split_at_mut(d);
    [shift, scale, gate]
}

impl Linear {
    /// (outputs, inputs).
    fn sizes(&self) -> Result<(usize, usize)> {
        self.weight.dims2()
    }

    /// Of rows `x`.
    fn apply(&self, x: &[f32]) -> Result<Buffer> {
        let mut y = self.product(x)?;
        linear::add_to_rows(&mut y, &self.bias()?);
        Ok(y)
    }

    /// The same without the bias.
    fn product(&self, x: &[f32]) -> Result<Buffer> {
        let (outputs, inputs) = self.sizes()?;
        let weight = host(&self.weight);
        let mut y = Buffer::of(x.len() / inputs * outputs);
        linear::forward(x, (outputs, inputs), weight.values()?, None, &mut y)?;
        Ok(y)
    }

    /// Zeros where it has none.
    fn bias(&self) -> Result<Buffer> {
        Ok(match &self.bias {
            Some(bias) => Buffer::copy_of(host(bias).values()?),
            None => Buffer::zeros(self.sizes()?.0),
        })
    }

    /// The gradient by rows `x`, of the gradient `g` by the result; those by the weights go to `gradients`.
    fn back(&self, x: &[f32], g: &[f32], gradients: &WeightGradients) -> Result<Buffer> {
        let (outputs, inputs) = self.sizes()?;
        let weight = host(&self.weight);
        let mut grad_x = Buffer::of(x.len());
        linear::input_gradient(g, (outputs, inputs), weight.values()?, &mut grad_x)?;
        let mut grad_weight = vec![0.0; outputs * inputs];
        linear::weight_gradient(g, (outputs, inputs), x, &mut grad_weight)?;
        gradients.add(&self.weight, grad_weight);
        if let Some(bias) = &self.bias {
            let mut sums = vec![0.0; outputs];
            linear::sum_rows(g, &mut sums);
            gradients.add(bias, sums);
        }
        Ok(grad_x)
    }
}

/// Frames of `width` values: of the clips in `values`, which hold `all`, those that are `kept`.
fn last_of(
    values: &[f32],
    width: usize,
    (all, kept): (Sizes, Sizes),
) -> impl Iterator<Item = &[f32]> {
    let clips = values.chunks_exact(all.t * width);
    clips.flat_map(move |clip| clip[(all.t - kept.t) * width..].chunks_exact(width))
}

fn last_of_mut(
    values: &mut [f32],
    width: usize,
    (all, kept): (Sizes, Sizes),
) -> impl Iterator<Item = &mut [f32]> {
    let clips = values.chunks_exact_mut(all.t * width);
    clips.flat_map(move |clip| clip[(all.t - kept.t) * width..].chunks_exact_mut(width))
}

/// The rows of the last frames of each clip alone.
fn without_others(values: Buffer, (all, kept): (Sizes, Sizes)) -> Buffer {
    if all.t == kept.t {
        return values;
    }
    let width = values.len() / (all.b * all.t);
    let mut out = Buffer::of(kept.b * kept.t * width);
    let frames = last_of(&values, width, (all, kept));
    for (out, frame) in out.chunks_exact_mut(width).zip(frames) {
        out.copy_from_slice(frame);
    }
    out
}

/// The rows of all frames, of those of the last ones; the others are zeros.
fn with_others(values: Buffer, (all, kept): (Sizes, Sizes)) -> Buffer {
    if all.t == kept.t {
        return values;
    }
    let width = values.len() / (kept.b * kept.t);
    let mut out = Buffer::zeros(all.b * all.t * width);
    let frames = values.chunks_exact(width);
    for (out, frame) in last_of_mut(&mut out, width, (all, kept)).zip(frames) {
        out.copy_from_slice(frame);
    }
    out
}

/// The normalised and modulated input of branch `branch`.
fn normed<'a>(
    input: &[f32],
    modulations: impl Iterator<Item = &'a [f32]>,
    branch: usize,
    sizes: Sizes,
) -> Buffer {
    let mut out = Buffer::of(input.len());
    let frames = out.chunks_exact_mut(sizes.frame());
    let frames = frames.zip(input.chunks_exact(sizes.frame()));
    for ((out, x), modulation) in frames.zip(modulations) {
        let [shift, scale, _] = chunks(modulation, branch, sizes.d);
        rms_norm_modulate::forward_frame(out, x, shift, scale);
    }
    out
}

/// `inputs` plus what branch `branch` adds: `output`, which gets its `bias` here, while it is in cache.
fn residual<'a, 'b>(
    inputs: impl Iterator<Item = &'a [f32]>,
    (output, bias): (&mut [f32], &[f32]),
    modulations: impl Iterator<Item = &'b [f32]>,
    branch: usize,
    sizes: Sizes,
) -> Buffer {
    let mut out = Buffer::of(output.len());
    let frames = out.chunks_exact_mut(sizes.frame()).zip(inputs);
    let frames = frames.zip(output.chunks_exact_mut(sizes.frame()));
    for (((out, input), output), modulation) in frames.zip(modulations) {
        let [.., gate] = chunks(modulation, branch, sizes.d);
        linear::add_to_rows(output, bias);
        out.copy_from_slice(input);
        gated_residual::forward_frame(out, output, gate);
    }
    out
}

impl SavedBranch {
    /// The gradient by what the branch adds, of the gradient `g` by the sum.
    fn gate_back<'a, 'b>(
        &self,
        g: &[f32],
        modulations: impl Iterator<Item = (&'a [f32], &'b mut [f32])>,
        branch: usize,
        sizes: Sizes,
    ) -> Buffer {
        let mut out = Buffer::of(g.len());
        let frames = out.chunks_exact_mut(sizes.frame());
        let frames = frames.zip(g.chunks_exact(sizes.frame()));
        let frames = frames.zip(self.output.chunks_exact(sizes.frame()));
        for (((out, g), output), (modulation, grad_modulation)) in frames.zip(modulations) {
            let [.., gate] = chunks(modulation, branch, sizes.d);
            let [.., grad_gate] = chunks_mut(grad_modulation, branch, sizes.d);
            gated_residual::backward_frame(out, grad_gate, output, g, gate);
        }
        out
    }

    /// Adds to `g` the gradient by the input, of the gradient `grad_normed` by the normalised one.
    fn norm_back<'a, 'b>(
        &self,
        g: &mut [f32],
        grad_normed: &[f32],
        modulations: impl Iterator<Item = (&'a [f32], &'b mut [f32])>,
        branch: usize,
        sizes: Sizes,
    ) {
        let mut by_input = Buffer::of(sizes.frame());
        let frames = g.chunks_exact_mut(sizes.frame());
        let frames = frames.zip(grad_normed.chunks_exact(sizes.frame()));
        let frames = frames.zip(self.input.chunks_exact(sizes.frame()));
        for (((g, grad_normed), input), (modulation, grad_modulation)) in frames.zip(modulations) {
            let [_, scale, _] = chunks(modulation, branch, sizes.d);
            let [grad_shift, grad_scale, _] = chunks_mut(grad_modulation, branch, sizes.d);
            rms_norm_modulate::backward_frame(
                &mut by_input,
                input,
                grad_normed,
                scale,
                grad_shift,
                grad_scale,
            );
            // The frame's gradient is still in cache.
            add(g, &by_input);
        }
    }
}

/// The branches of a sub-block, as their chunks of the modulation are numbered.
const ATTENTION: usize = 0;
const FEED_FORWARD: usize = 1;

impl SubBlock {
    /// The tokens of the last frames (`kept`) after it, and what to keep.
    fn run(
        &self,
        pattern: &AttentionPattern,
        input: Buffer,
        activated: &[f32],
        (all, kept): (Sizes, Sizes),
    ) -> Result<(Buffer, Saved)> {
        let modulation = self.modulation.apply(activated)?;
        let of_all = modulation.chunks_exact(all.modulation());
        let normed_input = normed(&input, of_all, ATTENTION, all);
        let qkv = self.qkv.product(&normed_input)?;
        let mut inner = Buffer::of(all.rows() * all.d);
        pattern.forward(&all.qkv(), &qkv, &mut inner)?;
        let inner = without_others(inner, (all, kept));
        let of_kept = || last_of(&modulation, all.modulation(), (all, kept));
        let mut output = self.out.product(&inner)?;
        let middle = residual(
            last_of(&input, all.frame(), (all, kept)),
            (&mut output, &self.out.bias()?),
            of_kept(),
            ATTENTION,
            kept,
        );
        let attention = SavedBranch {
            input,
            normed: normed_input,
            inner,
            output,
        };

        let normed_middle = normed(&middle, of_kept(), FEED_FORWARD, kept);
        let mut up = self.up.product(&normed_middle)?;
        let (_, hidden) = self.down.sizes()?;
        let mut inner = Buffer::of(kept.rows() * hidden);
        let bias = self.up.bias()?;
        let frames = inner.chunks_exact_mut(kept.n * hidden);
        for (inner, up) in frames.zip(up.chunks_exact_mut(kept.n * 2 * hidden)) {
            linear::add_to_rows(up, &bias);
            swiglu::forward_rows(inner, up, hidden);
        }
        let mut output = self.down.product(&inner)?;
        let tokens = residual(
            middle.chunks_exact(kept.frame()),
            (&mut output, &self.down.bias()?),
            of_kept(),
            FEED_FORWARD,
            kept,
        );
        let feed_forward = SavedBranch {
            input: middle,
            normed: normed_middle,
            inner,
            output,
        };
        let saved = Saved {
            modulation,
            attention,
            qkv,
            feed_forward,
            up,
        };
        Ok((tokens, saved))
    }

    /// Of the gradient `g` by the tokens after it: that by the tokens before, and that by `activated`.
    fn back(
        &self,
        pattern: &AttentionPattern,
        saved: &Saved,
        mut g: Buffer,
        activated: &[f32],
        (all, kept): (Sizes, Sizes),
        gradients: &WeightGradients,
    ) -> Result<(Buffer, Buffer)> {
        let modulation = &*saved.modulation;
        let mut grad_modulation = Buffer::zeros(modulation.len());
        let width = all.modulation();

        let branch = &saved.feed_forward;
        let by = last_of_mut(&mut grad_modulation, width, (all, kept));
        let by = last_of(modulation, width, (all, kept)).zip(by);
        let by_output = branch.gate_back(&g, by, FEED_FORWARD, kept);
        let by_inner = self.down.back(&branch.inner, &by_output, gradients)?;
        let (_, hidden) = self.down.sizes()?;
        let mut by_up = Buffer::of(saved.up.len());
        swiglu::backward_rows(&mut by_up, &saved.up, &by_inner, hidden);
        let by_normed = self.up.back(&branch.normed, &by_up, gradients)?;
        let by = last_of_mut(&mut grad_modulation, width, (all, kept));
        let by = last_of(modulation, width, (all, kept)).zip(by);
        branch.norm_back(&mut g, &by_normed, by, FEED_FORWARD, kept);

        let branch = &saved.attention;
        let by = last_of_mut(&mut grad_modulation, width, (all, kept));
        let by = last_of(modulation, width, (all, kept)).zip(by);
        let by_output = branch.gate_back(&g, by, ATTENTION, kept);
        let by_inner = self.out.back(&branch.inner, &by_output, gradients)?;
        let by_inner = with_others(by_inner, (all, kept));
        let mut by_qkv = Buffer::of(saved.qkv.len());
        pattern.backward(&all.qkv(), &saved.qkv, &by_inner, &mut by_qkv)?;
        let by_normed = self.qkv.back(&branch.normed, &by_qkv, gradients)?;
        let mut g = with_others(g, (all, kept));
        let by = modulation.chunks_exact(width);
        let by = by.zip(grad_modulation.chunks_exact_mut(width));
        branch.norm_back(&mut g, &by_normed, by, ATTENTION, all);

        let by_activated = self
            .modulation
            .back(activated, &grad_modulation, gradients)?;
        Ok((g, by_activated))
    }
}

impl Trunk {
    /// Sizes of what goes into each part, and of what comes out.
    fn sizes(&self, all: Sizes) -> impl DoubleEndedIterator<Item = (Sizes, Sizes)> {
        let count = self.parts.len();
        let last = self.last;
        (1..=count).map(move |part| match part == count {
            true => (all, all.last(last)),
            false => (all, all),
        })
    }

    fn saved(&self) -> MutexGuard<'_, Vec<Saved>> {
        self.saved.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CustomOp2 for Trunk {
    fn name(&self) -> &'static str {
        "transition blocks"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let sizes = Sizes::new(l1.shape(), l2.shape())?;
        if !(1..=sizes.t).contains(&self.last) {
            candle_core::bail!("blocks: the last {} of {} frames", self.last, sizes.t);
        }
        let (tokens, activated) = (slice(s1, l1)?, slice(s2, l2)?);
        let mut kept = self.saved();
        kept.clear();
        let mut tokens = Buffer::copy_of(tokens);
        for ((part, pattern), sizes) in self.parts.iter().zip(self.sizes(sizes)) {
            let (after, saved) = part.run(pattern, tokens, activated, sizes)?;
            tokens = after;
            kept.push(saved);
        }
        let shape = (sizes.b, self.last, sizes.n, sizes.d);
        Ok((CpuStorage::F32(tokens.to_vec()), shape.into()))
    }

    fn bwd(
        &self,
        tokens: &Tensor,
        activated: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let sizes = Sizes::new(tokens.shape(), activated.shape())?;
        let grad = grad.contiguous()?;
        let mut g = Buffer::copy_of(host(&grad).values()?);
        let values = host(activated);
        let values = values.values()?;
        let mut by_activated = vec![0.0; values.len()];
        let saved = self.saved();
        let parts = self.parts.iter().zip(&*saved);
        // Not by `rev` of a zip, whose lengths it must know.
        let parts: Vec<_> = parts.zip(self.sizes(sizes)).collect();
        for (((part, pattern), saved), sizes) in parts.into_iter().rev() {
            let gradients = &self.gradients;
            let by_part;
            (g, by_part) = part.back(pattern, saved, g, values, sizes, gradients)?;
            add(&mut by_activated, &by_part);
        }
        let by_tokens = Tensor::from_slice(&g, tokens.shape(), tokens.device())?;
        let by_activated = Tensor::from_vec(by_activated, activated.shape(), activated.device())?;
        Ok((Some(by_tokens), Some(by_activated)))
    }
}
