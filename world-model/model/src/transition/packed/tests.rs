//! The packed model against the reference on tensors.

use candle_core::{Device, Tensor};

use super::*;
use crate::transition::TemporalPattern;

fn values(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn random(shape: impl Into<candle_core::Shape>) -> Tensor {
    Tensor::randn(0f32, 1.0, shape, &Device::Cpu).unwrap()
}

/// Largest difference between the packed model's outputs, computed in passes of the frames `cut`
/// says, and the reference, which computes all frames at once.
fn difference(config: TransitionConfig, batch: usize, cut: &[usize]) -> f32 {
    let c = config.clone();
    let model = Transition::random(config, 3).unwrap();
    let packed = model.pack().unwrap();
    let t: usize = cut.iter().sum();
    let x = random((batch, t, c.latent_height, c.latent_width, c.channels));
    let tau = Tensor::rand(0f32, 1.0, (batch, t), &Device::Cpu).unwrap();
    let action = random((batch, t, c.action_dim));
    let whole = model
        .output(&x, &tau, &action, &TemporalPattern::causal(t), t)
        .unwrap();
    let frame = |tensor: &Tensor, i: usize| values(&tensor.narrow(1, i, 1).unwrap());
    let mut contexts: Vec<FrameContext> = Vec::new();
    let (mut most, mut size) = (0.0_f32, 1.0_f32);
    for count in cut {
        let first = contexts.len();
        let parts: Vec<_> = (first..first + count)
            .map(|i| (frame(&x, i), frame(&tau, i), frame(&action, i)))
            .collect();
        let frames: Vec<_> = parts
            .iter()
            .map(|(latents, tau, action)| NewFrame {
                latents,
                tau,
                action,
            })
            .collect();
        let earlier: Vec<_> = contexts.iter().collect();
        let mut pass = packed.pass(&earlier, &frames, frames.len(), 0).unwrap();
        assert_eq!(pass.outputs.len(), frames.len());
        for (i, output) in pass.outputs.iter().enumerate() {
            for (a, b) in output.iter().zip(frame(&whole, first + i)) {
                most = most.max((a - b).abs());
                size = size.max(b.abs());
            }
        }
        contexts.append(&mut pass.contexts);
    }
    most / size
}

#[test]
fn passes_in_any_cut_equal_the_reference() {
    let tiny = |grid: (usize, usize, usize), patch| {
        TransitionConfig::preset("tiny", grid, patch, 7).unwrap()
    };
    // Heads of 4, 12, 24 and 72 channels.
    let narrow = |hidden| TransitionConfig {
        hidden,
        heads: 2,
        depth: 2,
        ..tiny((6, 6, 4), 2)
    };
    let wide = TransitionConfig {
        wide_head: Some(96),
        ..tiny((8, 8, 4), 2)
    };
    let cases = [
        // One block of tokens, one that is not full, two of which one is not full, several.
        (tiny((8, 8, 4), 2), 2),
        (tiny((6, 4, 4), 2), 1),
        (tiny((10, 12, 4), 2), 2),
        (tiny((13, 11, 3), 1), 1),
        (wide, 2),
        (narrow(8), 1),
        (narrow(24), 2),
        (narrow(48), 1),
        (narrow(144), 1),
    ];
    for (config, batch) in cases {
        for cut in [&[1, 1, 1][..], &[3], &[2, 3], &[1, 4, 1]] {
            let most = difference(config.clone(), batch, cut);
            assert!(most < 1e-5, "{config:?} in {cut:?} differs by {most}");
        }
    }
}

#[test]
fn a_shared_context_is_that_of_every_candidate() {
    // Several blocks of tokens, the last one not full.
    let config = TransitionConfig::preset("tiny", (13, 11, 3), 1, 7).unwrap();
    let packed = Transition::random(config, 4).unwrap().pack().unwrap();
    let latents = values(&random((1, 13, 11, 3)));
    let zeros = [0.0; 14];
    let first = NewFrame {
        latents: &latents,
        tau: &[0.0],
        action: &zeros[..7],
    };
    let context = packed.pass(&[], &[first], 1, 1).unwrap().contexts;
    let both = values(&random((2, 13, 11, 3)));
    let next = |latents, tau, action| {
        let frame = NewFrame {
            latents,
            tau,
            action,
        };
        let earlier: Vec<_> = context.iter().collect();
        packed
            .pass(&earlier, &[frame], 0, 0)
            .unwrap()
            .outputs
            .remove(0)
    };
    let together = next(&both, &[1.0, 1.0], &zeros);
    let (a, b) = both.split_at(both.len() / 2);
    let alone = [next(a, &[1.0], &zeros[..7]), next(b, &[1.0], &zeros[..7])].concat();
    assert_eq!(together, alone);
}

#[test]
fn a_pass_may_keep_some_frames_and_give_others() {
    let config = TransitionConfig::preset("tiny", (6, 6, 4), 2, 7).unwrap();
    let packed = Transition::random(config, 4).unwrap().pack().unwrap();
    let latents: Vec<_> = (0..3).map(|_| values(&random((1, 6, 6, 4)))).collect();
    let frames: Vec<_> = latents
        .iter()
        .map(|latents| NewFrame {
            latents,
            tau: &[0.3],
            action: &[0.5; 7],
        })
        .collect();
    let whole = packed.pass(&[], &frames, 3, 0).unwrap();
    for (keep, first) in [(1, 1), (1, 2), (2, 1), (0, 2), (3, 3)] {
        let part = packed.pass(&[], &frames, keep, first).unwrap();
        assert_eq!(part.contexts.len(), keep);
        assert_eq!(part.outputs, whole.outputs[first..]);
        let earlier: Vec<_> = part.contexts.iter().collect();
        let rest = packed.pass(&earlier, &frames[keep..], 0, 0);
        if keep < 3 {
            assert_eq!(rest.unwrap().outputs, whole.outputs[keep..]);
        }
    }
    let other = TransitionConfig::preset("tiny", (6, 6, 4), 2, 7).unwrap();
    let other = Transition::random(other, 4).unwrap().pack().unwrap();
    let earlier: Vec<_> = whole.contexts.iter().collect();
    let message = other.pass(&earlier, &frames, 0, 0).unwrap_err().to_string();
    assert!(message.contains("one of this model"), "{message}");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let config = TransitionConfig::preset("tiny", (8, 8, 4), 2, 7).unwrap();
    let packed = Transition::random(config, 4).unwrap().pack().unwrap();
    let frame = NewFrame {
        latents: &[0.0; 255],
        tau: &[0.0],
        action: &[0.0; 7],
    };
    let refused = |frames: &[NewFrame<'_>]| packed.pass(&[], frames, 0, 0).unwrap_err().to_string();
    assert!(refused(&[]).starts_with("the new frames"));
    assert!(refused(&[frame; 11]).starts_with("the new frames"));
    let message = refused(&[frame]);
    assert!(
        message.contains("256") && message.contains("255"),
        "{message}"
    );
}
