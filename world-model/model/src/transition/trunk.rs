//! All blocks as one operation, for training on the CPU.
//!
//! Candle's backward pass fills a tensor with zeros for each operand of each operation and adds the gradient to it, and
//! every result is a new tensor: for a model as small as the embedded default that is a quarter of a step. This operation
//! keeps what its backward pass needs in buffers that are used again, and adds in place. An operation of candle's has three
//! operands at most, so that gradients by weights go another way: [`WeightGradients`].

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor, backprop::GradStore};

use super::block::{Block, SubBlock};
use super::parameters::Linear;
use crate::ops::buffer::Buffer;
use crate::ops::host::{host, slice};
use crate::ops::{AttentionPattern, gated_residual, linear, rms_norm_modulate, swiglu};

/// Chunks of a frame's modulation: shift, scale and gate of the attention, then of the feed-forward network.
const CHUNKS: usize = 6;

/// A weight and the gradient by it.
type Gradient = (Tensor, Vec<f32>);

/// Gradients by weights that are no operands of candle's operations; see [`super::Transition::collecting`].
#[derive(Clone, Debug, Default)]
pub struct WeightGradients(Arc<Mutex<Vec<Gradient>>>);

impl WeightGradients {
    /// Adds them to those of candle's own backward pass, and forgets them.
    ///
    /// # Errors
    /// If a gradient that `store` has already is of another shape.
    pub fn move_into(&self, store: &mut GradStore) -> Result<()> {
        for (weight, values) in self.lock().drain(..) {
            let gradient = Tensor::from_vec(values, weight.shape(), weight.device())?;
            let gradient = match store.get(&weight) {
                Some(other) => (other + gradient)?,
                None => gradient,
            };
            store.insert(&weight, gradient);
        }
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Gradient>> {
        // A list of whole entries is consistent whoever panicked.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// `tokens` (B, T, N, d) after all `blocks`, for frames whose modulations start from `activated` (B T, d).
///
/// # Errors
/// If the shapes do not fit.
pub(super) fn trunk(
    blocks: &[Block],
    patterns: [&Arc<AttentionPattern>; 2],
    gradients: &WeightGradients,
    tokens: &Tensor,
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
        saved: Mutex::default(),
        gradients: gradients.clone(),
    };
    tokens.contiguous()?.apply_op2(&activated.contiguous()?, op)
}

struct Trunk {
    parts: Vec<(SubBlock, Arc<AttentionPattern>)>,
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
        let (outputs, inputs) = self.sizes()?;
        let (weight, bias) = (host(&self.weight), self.bias.as_ref().map(host));
        let bias = bias.as_ref().map(|bias| bias.values()).transpose()?;
        let mut y = Buffer::of(x.len() / inputs * outputs);
        linear::forward(x, (outputs, inputs), weight.values()?, bias, &mut y)?;
        Ok(y)
    }

    /// The gradient by rows `x`, of the gradient `g` by the result; those by the weights go to `gradients`.
    fn back(&self, x: &[f32], g: &[f32], gradients: &WeightGradients) -> Result<Buffer> {
        let (outputs, inputs) = self.sizes()?;
        let weight = host(&self.weight);
        let mut grad_x = Buffer::of(x.len());
        linear::input_gradient(g, (outputs, inputs), weight.values()?, &mut grad_x)?;
        let mut grad_weight = vec![0.0; outputs * inputs];
        linear::weight_gradient(g, (outputs, inputs), x, &mut grad_weight)?;
        let mut gradients = gradients.lock();
        gradients.push((self.weight.clone(), grad_weight));
        if let Some(bias) = &self.bias {
            let mut sums = vec![0.0; outputs];
            linear::sum_rows(g, &mut sums);
            gradients.push((bias.clone(), sums));
        }
        Ok(grad_x)
    }
}

/// The normalised and modulated input of branch `branch`.
fn normed(input: &[f32], modulation: &[f32], branch: usize, sizes: Sizes) -> Buffer {
    let Sizes { n, d, .. } = sizes;
    let mut out = Buffer::of(input.len());
    let frames = out.chunks_exact_mut(n * d).zip(input.chunks_exact(n * d));
    for ((out, x), modulation) in frames.zip(modulation.chunks_exact(CHUNKS * d)) {
        let [shift, scale, _] = chunks(modulation, branch, d);
        rms_norm_modulate::forward_frame(out, x, shift, scale);
    }
    out
}

/// `input` plus what branch `branch` adds.
fn residual(
    input: &[f32],
    output: &[f32],
    modulation: &[f32],
    branch: usize,
    sizes: Sizes,
) -> Buffer {
    let Sizes { n, d, .. } = sizes;
    let mut out = Buffer::copy_of(input);
    let frames = out.chunks_exact_mut(n * d).zip(output.chunks_exact(n * d));
    for ((out, branch_output), modulation) in frames.zip(modulation.chunks_exact(CHUNKS * d)) {
        let [.., gate] = chunks(modulation, branch, d);
        gated_residual::forward_frame(out, branch_output, gate);
    }
    out
}

impl SavedBranch {
    /// The gradient by what the branch adds, of the gradient `g` by the sum.
    fn gate_back(
        &self,
        g: &[f32],
        (modulation, grad_modulation): (&[f32], &mut [f32]),
        branch: usize,
        sizes: Sizes,
    ) -> Buffer {
        let Sizes { n, d, .. } = sizes;
        let mut out = Buffer::of(g.len());
        let frames = out.chunks_exact_mut(n * d).zip(g.chunks_exact(n * d));
        let frames = frames.zip(self.output.chunks_exact(n * d));
        let modulations = modulation.chunks_exact(CHUNKS * d);
        let modulations = modulations.zip(grad_modulation.chunks_exact_mut(CHUNKS * d));
        for (((out, g), output), (modulation, grad_modulation)) in frames.zip(modulations) {
            let [.., gate] = chunks(modulation, branch, d);
            let [.., grad_gate] = chunks_mut(grad_modulation, branch, d);
            gated_residual::backward_frame(out, grad_gate, output, g, gate);
        }
        out
    }

    /// Adds to `g` the gradient by the input, of the gradient `grad_normed` by the normalised one.
    fn norm_back(
        &self,
        g: &mut [f32],
        grad_normed: &[f32],
        (modulation, grad_modulation): (&[f32], &mut [f32]),
        branch: usize,
        sizes: Sizes,
    ) {
        let Sizes { n, d, .. } = sizes;
        let mut by_input = Buffer::of(n * d);
        let frames = g.chunks_exact_mut(n * d);
        let frames = frames.zip(grad_normed.chunks_exact(n * d));
        let frames = frames.zip(self.input.chunks_exact(n * d));
        let modulations = modulation.chunks_exact(CHUNKS * d);
        let modulations = modulations.zip(grad_modulation.chunks_exact_mut(CHUNKS * d));
        for (((g, grad_normed), input), (modulation, grad_modulation)) in frames.zip(modulations) {
            let [_, scale, _] = chunks(modulation, branch, d);
            let [grad_shift, grad_scale, _] = chunks_mut(grad_modulation, branch, d);
            rms_norm_modulate::backward_frame(
                &mut by_input,
                input,
                grad_normed,
                scale,
                grad_shift,
                grad_scale,
            );
            // The frame's gradient is still in cache.
            for (g, by_input) in g.iter_mut().zip(&*by_input) {
                *g += by_input;
            }
        }
    }
}

/// The branches of a sub-block, as their chunks of the modulation are numbered.
const ATTENTION: usize = 0;
const FEED_FORWARD: usize = 1;

impl SubBlock {
    /// The tokens after it, and what to keep.
    fn run(
        &self,
        pattern: &AttentionPattern,
        input: Buffer,
        activated: &[f32],
        sizes: Sizes,
    ) -> Result<(Buffer, Saved)> {
        let modulation = self.modulation.apply(activated)?;
        let normed_input = normed(&input, &modulation, ATTENTION, sizes);
        let qkv = self.qkv.apply(&normed_input)?;
        let mut inner = Buffer::of(sizes.rows() * sizes.d);
        pattern.forward(&sizes.qkv(), &qkv, &mut inner)?;
        let output = self.out.apply(&inner)?;
        let middle = residual(&input, &output, &modulation, ATTENTION, sizes);
        let attention = SavedBranch {
            input,
            normed: normed_input,
            inner,
            output,
        };

        let normed_middle = normed(&middle, &modulation, FEED_FORWARD, sizes);
        let up = self.up.apply(&normed_middle)?;
        let (_, hidden) = self.down.sizes()?;
        let mut inner = Buffer::of(sizes.rows() * hidden);
        swiglu::forward_rows(&mut inner, &up, hidden);
        let output = self.down.apply(&inner)?;
        let tokens = residual(&middle, &output, &modulation, FEED_FORWARD, sizes);
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

    /// Turns `g`, the gradient by the tokens after it, into that by the tokens before; gives that by `activated`.
    fn back(
        &self,
        pattern: &AttentionPattern,
        saved: &Saved,
        g: &mut [f32],
        activated: &[f32],
        sizes: Sizes,
        gradients: &WeightGradients,
    ) -> Result<Buffer> {
        let modulation = &*saved.modulation;
        let mut grad_modulation = Buffer::zeros(modulation.len());

        let branch = &saved.feed_forward;
        let by = (modulation, &mut *grad_modulation);
        let by_output = branch.gate_back(g, by, FEED_FORWARD, sizes);
        let by_inner = self.down.back(&branch.inner, &by_output, gradients)?;
        let (_, hidden) = self.down.sizes()?;
        let mut by_up = Buffer::of(saved.up.len());
        swiglu::backward_rows(&mut by_up, &saved.up, &by_inner, hidden);
        let by_normed = self.up.back(&branch.normed, &by_up, gradients)?;
        let by = (modulation, &mut *grad_modulation);
        branch.norm_back(g, &by_normed, by, FEED_FORWARD, sizes);

        let branch = &saved.attention;
        let by = (modulation, &mut *grad_modulation);
        let by_output = branch.gate_back(g, by, ATTENTION, sizes);
        let by_inner = self.out.back(&branch.inner, &by_output, gradients)?;
        let mut by_qkv = Buffer::of(saved.qkv.len());
        pattern.backward(&sizes.qkv(), &saved.qkv, &by_inner, &mut by_qkv)?;
        let by_normed = self.qkv.back(&branch.normed, &by_qkv, gradients)?;
        let by = (modulation, &mut *grad_modulation);
        branch.norm_back(g, &by_normed, by, ATTENTION, sizes);

        self.modulation.back(activated, &grad_modulation, gradients)
    }
}

impl Trunk {
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
        let (tokens, activated) = (slice(s1, l1)?, slice(s2, l2)?);
        let mut kept = self.saved();
        kept.clear();
        let mut tokens = Buffer::copy_of(tokens);
        for (part, pattern) in &self.parts {
            let (after, saved) = part.run(pattern, tokens, activated, sizes)?;
            tokens = after;
            kept.push(saved);
        }
        Ok((CpuStorage::F32(tokens.to_vec()), l1.shape().clone()))
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
        for ((part, pattern), saved) in self.parts.iter().zip(&*self.saved()).rev() {
            let gradients = &self.gradients;
            let by_part = part.back(pattern, saved, &mut g, values, sizes, gradients)?;
            for (sum, by_part) in by_activated.iter_mut().zip(&*by_part) {
                *sum += by_part;
            }
        }
        let by_tokens = Tensor::from_slice(&g, tokens.shape(), tokens.device())?;
        let by_activated = Tensor::from_vec(by_activated, activated.shape(), activated.device())?;
        Ok((Some(by_tokens), Some(by_activated)))
    }
}
