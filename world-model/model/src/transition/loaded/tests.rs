//! Both forms of the loaded model against the reference on tensors.

use candle_core::Tensor;

use super::*;
use crate::transition::{TemporalPattern, Transition};
use crate::{NumberFormat, random};

fn values(tensor: &Tensor) -> Vec<f32> {
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

fn random(shape: &[usize], seed: u64) -> Tensor {
    random::normal(shape, seed).unwrap()
}

/// On kernels, on tensor operations, and on these as a device computes that records.
fn every_form(config: &TransitionConfig) -> [LoadedTransition; 3] {
    let model = Transition::random(config.clone(), 4).unwrap();
    let on_tensors = |recorded| TensorTransition::new(model.clone(), recorded).unwrap();
    [
        model.pack().unwrap(),
        on_tensors(false).into(),
        on_tensors(true).into(),
    ]
}

const FORMS: [&str; 3] = ["on kernels", "on tensors", "as recorded"];

/// Checks that outputs are about the same: to 1e-5 of the largest, and on kernels to the last bit.
#[track_caller]
fn check_same(model: &LoadedTransition, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len());
    match model {
        LoadedTransition::Packed(_) => assert_eq!(found, expected),
        LoadedTransition::Tensors(_) => {
            let size = expected.iter().fold(1.0_f32, |most, v| most.max(v.abs()));
            let pairs = found.iter().zip(expected);
            let most = pairs.fold(0.0_f32, |most, (a, b)| most.max((a - b).abs()));
            assert!(most < 1e-5 * size, "they differ by {most}");
        }
    }
}

/// Largest difference between a model's outputs, computed in passes of the frames `cut` says, and the reference, which
/// computes all frames at once.
fn difference(
    packed: &LoadedTransition,
    reference: &Transition,
    batch: usize,
    cut: &[usize],
) -> f32 {
    let c = packed.config();
    let t: usize = cut.iter().sum();
    let x = random(&[batch, t, c.latent_height, c.latent_width, c.channels], 1);
    let tau = random::uniform(&[batch, t], 2).unwrap();
    let action = random(&[batch, t, c.action_dim], 3);
    let whole = reference
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
        let reference = Transition::random(config.clone(), 4).unwrap();
        for cut in [&[1, 1, 1][..], &[3], &[2, 3], &[1, 4, 1]] {
            for (model, form) in every_form(&config).iter().zip(FORMS) {
                let most = difference(model, &reference, batch, cut);
                assert!(
                    most < 1e-5,
                    "{config:?} {form} in {cut:?} differs by {most}"
                );
            }
        }
    }
}

#[test]
fn a_shared_context_is_that_of_every_candidate() {
    // Several blocks of tokens, the last one not full.
    let config = TransitionConfig::preset("tiny", (13, 11, 3), 1, 7).unwrap();
    let latents = values(&random(&[1, 13, 11, 3], 1));
    let both = values(&random(&[2, 13, 11, 3], 2));
    let zeros = [0.0; 14];
    for model in every_form(&config) {
        let first = NewFrame {
            latents: &latents,
            tau: &[0.0],
            action: &zeros[..7],
        };
        let context = model.pass(&[], &[first], 1, 1).unwrap().contexts;
        let next = |latents, tau, action| {
            let frame = NewFrame {
                latents,
                tau,
                action,
            };
            let earlier: Vec<_> = context.iter().collect();
            let mut pass = model.pass(&earlier, &[frame], 0, 0).unwrap();
            pass.outputs.remove(0)
        };
        let together = next(&both, &[1.0, 1.0], &zeros);
        let (a, b) = both.split_at(both.len() / 2);
        let alone = [next(a, &[1.0], &zeros[..7]), next(b, &[1.0], &zeros[..7])].concat();
        check_same(&model, &together, &alone);
    }
}

#[test]
fn a_pass_may_keep_some_frames_and_give_others() {
    let config = TransitionConfig::preset("tiny", (6, 6, 4), 2, 7).unwrap();
    let latents: Vec<_> = (0..3).map(|i| values(&random(&[1, 6, 6, 4], i))).collect();
    let frames: Vec<_> = latents
        .iter()
        .map(|latents| NewFrame {
            latents,
            tau: &[0.3],
            action: &[0.5; 7],
        })
        .collect();
    let reference = Transition::random(config.clone(), 4).unwrap();
    let rounded = [NumberFormat::Bf16, NumberFormat::Int8]
        .map(|format| PackedTransition::new(&reference, format).unwrap().into());
    for model in every_form(&config).into_iter().chain(rounded) {
        let check = |found: &[Vec<f32>], expected: &[Vec<f32>]| {
            check_same(&model, &found.concat(), &expected.concat());
        };
        let whole = model.pass(&[], &frames, 3, 0).unwrap();
        for (keep, first) in [(1, 1), (1, 2), (2, 1), (0, 2), (3, 3)] {
            let part = model.pass(&[], &frames, keep, first).unwrap();
            assert_eq!(part.contexts.len(), keep);
            check(&part.outputs, &whole.outputs[first..]);
            let earlier: Vec<_> = part.contexts.iter().collect();
            let rest = model.pass(&earlier, &frames[keep..], 0, 0);
            if keep < 3 {
                check(&rest.unwrap().outputs, &whole.outputs[keep..]);
            }
        }
        let earlier: Vec<_> = whole.contexts.iter().collect();
        for other in every_form(&config) {
            let message = other.pass(&earlier, &frames, 0, 0).unwrap_err().to_string();
            assert!(message.contains("one of this model"), "{message}");
        }
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let config = TransitionConfig::preset("tiny", (8, 8, 4), 2, 7).unwrap();
    let frame = NewFrame {
        latents: &[0.0; 255],
        tau: &[0.0],
        action: &[0.0; 7],
    };
    for model in every_form(&config) {
        let refused =
            |frames: &[NewFrame<'_>]| model.pass(&[], frames, 0, 0).unwrap_err().to_string();
        assert!(refused(&[]).starts_with("the new frames"));
        assert!(refused(&[frame; 11]).starts_with("the new frames"));
        let message = refused(&[frame]);
        assert!(
            message.contains("256") && message.contains("255"),
            "{message}"
        );
        let message = refused(&[NewFrame {
            action: &[0.0; 6],
            ..frame
        }]);
        assert!(message.contains('7') && message.contains('6'), "{message}");
    }
}

/// Passes of more shapes than are kept, each several times, with other frames before them each time.
#[test]
fn what_is_recorded_is_what_would_be_computed() {
    let config = TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap();
    let [_, plain, recorded] = every_form(&config);
    for round in 0..3 {
        for candidates in 1..=14 {
            let of = |model: &LoadedTransition, shared: usize, own: usize| -> Vec<Vec<f32>> {
                let mut contexts: Vec<FrameContext> = Vec::new();
                for index in 0..shared + own {
                    let batch = if index < shared { 1 } else { candidates };
                    let kept = pass(model, &contexts, (batch, round * 10 + index), 1);
                    contexts.extend(kept.contexts);
                }
                // Two Euler steps of a frame.
                [50, 60]
                    .into_iter()
                    .flat_map(|seed| pass(model, &contexts, (candidates, seed + round), 0).outputs)
                    .collect()
            };
            for (shared, own) in [(2, 0), (1, 1)] {
                assert_eq!(
                    of(&recorded, shared, own),
                    of(&plain, shared, own),
                    "{candidates} candidates after {shared} shared frames and {own} others, round {round}"
                );
            }
        }
    }
}

/// A pass over one frame of values that depend on `seed`, whose context is kept or whose output is given.
fn pass(
    model: &LoadedTransition,
    earlier: &[FrameContext],
    (batch, seed): (usize, usize),
    keep: usize,
) -> PassOutput {
    let wave = |count: usize| -> Vec<f32> {
        let value = |i: usize| ((i * 7 + seed * 131) as f32 * 0.37).sin();
        (0..count).map(value).collect()
    };
    let (latents, action) = (wave(batch * 64), wave(batch * 7));
    let frame = NewFrame {
        latents: &latents,
        tau: &vec![0.5; batch],
        action: &action,
    };
    let earlier: Vec<_> = earlier.iter().collect();
    model.pass(&earlier, &[frame], keep, keep).unwrap()
}
