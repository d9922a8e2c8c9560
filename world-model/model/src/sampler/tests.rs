use std::sync::LazyLock;

use candle_core::{D, Device, Tensor};

use super::*;
use crate::transition::{
    ActionAlignment, Parametrisation, TensorTransition, Transition, TransitionConfig,
};

/// A small model whose window is full after two predictions from two frames.
fn model(
    parametrisation: Parametrisation,
    action_alignment: ActionAlignment,
) -> (Transition, LoadedTransition) {
    let config = TransitionConfig {
        hidden: 64,
        depth: 2,
        heads: 2,
        max_frames: 4,
        parametrisation,
        action_alignment,
        ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap()
    };
    let model = Transition::random(config, 5).unwrap();
    let packed = model.pack().unwrap();
    (model, packed)
}

static PLAIN: LazyLock<(Transition, LoadedTransition)> =
    LazyLock::new(|| model(Parametrisation::Velocity, ActionAlignment::WithFrame));
static TINY: LazyLock<(Transition, LoadedTransition)> =
    LazyLock::new(|| model(Parametrisation::Residual, ActionAlignment::WithResult));

/// The model on kernels, on tensor operations, and on these as a device computes that records.
fn every_form((model, packed): &(Transition, LoadedTransition)) -> [LoadedTransition; 3] {
    let on_tensors = |recorded| TensorTransition::new(model.clone(), recorded).unwrap();
    [
        packed.clone(),
        on_tensors(false).into(),
        on_tensors(true).into(),
    ]
}

fn random(shape: &[usize], seed: u64) -> Tensor {
    crate::random::normal(shape, seed).unwrap()
}

fn most(a: &Tensor, b: &Tensor) -> f32 {
    let difference = (a - b).unwrap().abs().unwrap();
    difference.max_all().unwrap().to_scalar().unwrap()
}

/// The definition: every Euler step computes the whole window.
fn uncached(
    model: &Transition,
    sampler: &Sampler,
    context: &Tensor,
    actions: &Tensor,
    steps: usize,
    seed: u64,
) -> Vec<Tensor> {
    let config = model.config();
    let given = context.dim(1).unwrap();
    let mut frames = context.clone();
    let zero = Tensor::zeros(
        (1, config.action_dim),
        candle_core::DType::F32,
        &Device::Cpu,
    )
    .unwrap();
    for k in 0..steps {
        let first = (given + k + 1).saturating_sub(config.max_frames);
        let window = given + k - first;
        let clean = frames.narrow(1, first, window).unwrap();
        // Actions first..first + window lead from each clean frame to the next, the last one to
        // the new frame.
        let between = actions.narrow(0, first, window).unwrap();
        // The last action goes on.
        let own = between.narrow(0, window - 1, 1).unwrap();
        let fed = match config.action_alignment {
            ActionAlignment::WithFrame => Tensor::cat(&[&between, &own], 0),
            ActionAlignment::WithResult => Tensor::cat(&[&zero, &between], 0),
        };
        let fed = fed.unwrap().unsqueeze(0).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(k as u64);
        let values: Vec<f32> = (0..4 * 4 * 4)
            .map(|_| StandardNormal.sample(&mut rng))
            .collect();
        let mut x = Tensor::from_vec(values, (1, 1, 4, 4, 4), &Device::Cpu).unwrap();
        let levels = sampler.levels();
        for pair in levels.windows(2) {
            let mut tau = vec![sampler.context_tau as f32; window];
            tau.push(pair[0] as f32);
            let tau = Tensor::from_vec(tau, (1, window + 1), &Device::Cpu).unwrap();
            let whole = Tensor::cat(&[&clean, &x], 1).unwrap();
            let velocity = model.forward(&whole, &tau, &fed).unwrap();
            let velocity = velocity.narrow(1, window, 1).unwrap();
            x = (x - (velocity * (pair[0] - pair[1])).unwrap()).unwrap();
        }
        frames = Tensor::cat(&[&frames, &x], 1).unwrap();
    }
    (0..steps)
        .map(|k| frames.narrow(1, given + k, 1).unwrap().squeeze(1).unwrap())
        .collect()
}

#[test]
fn cached_rollout_equals_uncached_one_as_the_window_slides() {
    for (both, given) in [(&*PLAIN, 2), (&*TINY, 2), (&*TINY, 1), (&*PLAIN, 6)] {
        let model = &both.0;
        let sampler = Sampler {
            // More than are modulated together, too.
            steps: if given == 1 { 18 } else { 2 },
            shift: 2.0,
            context_tau: 0.01,
        };
        let steps = 5;
        let context = random(&[1, given, 4, 4, 4], 1);
        let actions = random(&[given - 1 + steps, 7], 2);
        let expected = uncached(model, &sampler, &context, &actions, steps, 9);
        let past = (given > 1).then(|| actions.narrow(0, 0, given - 1).unwrap());
        for form in every_form(both) {
            let mut rollout = Rollout::new(&form, &sampler, &context, past.as_ref(), 9).unwrap();
            for (k, expected) in expected.iter().enumerate() {
                let action = actions.narrow(0, given - 1 + k, 1).unwrap();
                let got = rollout.next(&action).unwrap();
                let size = expected.abs().unwrap().max_all().unwrap();
                let size = size.to_scalar::<f32>().unwrap();
                let difference = most(&got, expected) / size.max(1.0);
                assert!(difference < 1e-5, "step {k} differs by {difference}");
            }
            assert_eq!(rollout.steps_taken(), steps);
        }
    }
}

#[test]
fn candidates_are_what_they_would_be_alone() {
    for model in [&*PLAIN, &*TINY].into_iter().flat_map(every_form) {
        let model = &model;
        let sampler = model.config().sampler.clone();
        let context = random(&[1, 2, 4, 4, 4], 1);
        let past = random(&[1, 7], 2);
        let mut rollout = Rollout::new(model, &sampler, &context, Some(&past), 4).unwrap();
        rollout.prepare().unwrap();
        let mut together = rollout.candidates(3).unwrap();
        let mut alone: Vec<_> = (0..3).map(|_| rollout.clone()).collect();
        for step in 0..4 {
            let actions = random(&[3, 7], 10 + step);
            let all = together.next(&actions).unwrap();
            for (i, alone) in alone.iter_mut().enumerate() {
                let one = alone.next(&actions.narrow(0, i, 1).unwrap()).unwrap();
                let difference = most(&all.narrow(0, i, 1).unwrap(), &one);
                assert!(
                    difference < 1e-4,
                    "candidate {i}, step {step}: {difference}"
                );
            }
        }
    }
}

#[test]
fn the_seed_decides_every_byte() {
    let context = random(&[1, 2, 4, 4, 4], 1);
    let past = random(&[1, 7], 2);
    let run = |seed: u64| -> Vec<f32> {
        let sampler = Sampler {
            steps: 3,
            ..Sampler::default()
        };
        let mut rollout = Rollout::new(&PLAIN.1, &sampler, &context, Some(&past), seed).unwrap();
        let frames: Vec<_> = (0..3)
            .map(|i| rollout.next(&random(&[1, 7], i)).unwrap())
            .collect();
        let all = Tensor::cat(&frames, D::Minus1).unwrap();
        all.flatten_all().unwrap().to_vec1().unwrap()
    };
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn levels_run_from_noise_to_clean_and_are_shifted() {
    let sampler = Sampler {
        steps: 2,
        shift: 3.0,
        context_tau: 0.0,
    };
    assert_eq!(sampler.levels(), [1.0, 0.75, 0.0]);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let sampler = Sampler::default();
    let context = random(&[1, 2, 4, 4, 4], 1);
    let refused = |context: &Tensor, past: Option<&Tensor>| {
        let error = Rollout::new(&PLAIN.1, &sampler, context, past, 0).unwrap_err();
        error.to_string()
    };
    assert!(refused(&context, None).starts_with("the actions of the context"));
    assert!(refused(&random(&[1, 2, 4, 4, 5], 1), None).starts_with("the context has shape"));
    let infinite = (&context / 0.0).unwrap();
    assert!(refused(&infinite, Some(&random(&[1, 7], 1))).contains("not finite"));

    let past = random(&[1, 7], 1);
    let mut rollout = Rollout::new(&PLAIN.1, &sampler, &context, Some(&past), 0).unwrap();
    let message = rollout.next(&random(&[2, 7], 1)).unwrap_err().to_string();
    assert!(message.starts_with("the action has shape"), "{message}");
    assert!(rollout.candidates(0).is_err());
    let zero = Sampler {
        steps: 0,
        ..Sampler::default()
    };
    assert!(
        zero.validate()
            .unwrap_err()
            .to_string()
            .starts_with("steps")
    );
}

/// Three rollouts of unlike pasts, seeds and ages, side by side and each alone, whose window slides meanwhile; and one
/// that is taken up again from its last frames.
#[test]
fn rows_of_a_batch_are_computed_as_if_alone() {
    for (_, model) in [&*PLAIN, &*TINY] {
        let sampler = &model.config().sampler;
        let context = random(&[3, 2, 4, 4, 4], 1);
        let past = random(&[3, 1, 7], 2);
        let actions = random(&[5, 3, 7], 3);
        let noise = [(4, 0), (4, 7), (5, 0)].map(|(seed, first_step)| Noise { seed, first_step });
        let mut together = Rollout::batch(model, sampler, &context, Some(&past), &noise).unwrap();
        let mut alone: Vec<Rollout<'_>> = (0..3)
            .map(|row| {
                let context = context.narrow(0, row, 1).unwrap();
                let past = past.narrow(0, row, 1).unwrap();
                Rollout::batch(model, sampler, &context, Some(&past), &noise[row..=row]).unwrap()
            })
            .collect();
        for step in 0..5 {
            let action = actions.get(step).unwrap();
            let rows = together.next(&action).unwrap();
            for (row, alone) in alone.iter_mut().enumerate() {
                let action = action.narrow(0, row, 1).unwrap().contiguous().unwrap();
                let own = alone.next(&action).unwrap();
                assert_eq!(
                    most(&rows.narrow(0, row, 1).unwrap(), &own),
                    0.0,
                    "row {row}, step {step}"
                );
            }
        }
        let error = Rollout::batch(model, sampler, &context, Some(&past), &noise[..2]);
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("2 for a batch of 3")
        );
    }
}

/// Under both alignments of actions, before and after the window slides.
#[test]
fn a_rollout_goes_on_from_the_position_of_another_bit_for_bit() {
    for (_, model) in [&*PLAIN, &*TINY] {
        let sampler = &model.config().sampler;
        let context = random(&[1, 2, 4, 4, 4], 1);
        let past = random(&[1, 7], 2);
        let actions = random(&[6, 1, 7], 3);
        let mut rollout = Rollout::new(model, sampler, &context, Some(&past), 4).unwrap();
        for step in 0..6 {
            let position = rollout.position().unwrap();
            let mut resumed = Rollout::resume(model, sampler, &position).unwrap();
            // What the other has prepared makes no difference.
            rollout.prepare().unwrap();
            let action = actions.get(step).unwrap();
            let own = actions.get((step + 1) % 6).unwrap();
            let given = Given {
                own_action: Some(&own),
                ..Given::default()
            };
            let goes_on = rollout.next_given(&action, given).unwrap();
            let again = resumed.next_given(&action, given).unwrap();
            assert_eq!(most(&goes_on, &again), 0.0, "step {step}");
        }
        let several = rollout.candidates(2).unwrap().position().unwrap_err();
        assert!(several.to_string().contains("position of 2"), "{several}");
    }
}

/// What was computed of the frames before the newest one serves the rollout from it; what is of other frames or actions
/// does not. With its result, a frame is fed the action before it: the first frame depends on none.
#[test]
fn rollout_from_computed_first_frames_has_the_same_bits() {
    for ((_, model), expected) in [(&*PLAIN, [0, 0, 1]), (&*TINY, [0, 1, 2])] {
        let sampler = &model.config().sampler;
        let context = random(&[1, 3, 4, 4, 4], 1);
        let past = random(&[2, 7], 2);
        let earlier = context.narrow(1, 0, 2).unwrap();
        let between = past.narrow(0, 0, 1).unwrap();
        let prepared = |context: &Tensor, past: &Tensor| {
            let mut rollout = Rollout::new(model, sampler, context, Some(past), 0).unwrap();
            rollout.prepare().unwrap();
            rollout.prepared()
        };
        let of_other_frames = prepared(&random(&[1, 2, 4, 4, 4], 9), &between);
        let of_other_actions = prepared(&earlier, &random(&[1, 7], 9));
        let of_these = prepared(&earlier, &between);

        let new = || Rollout::new(model, sampler, &context, Some(&past), 4).unwrap();
        let next = |rollout: &mut Rollout<'_>| rollout.next(&random(&[1, 7], 3)).unwrap();
        let alone = next(&mut new());
        for (prepared, expected) in [of_other_frames, of_other_actions, of_these]
            .iter()
            .zip(expected)
        {
            let mut rollout = new();
            assert_eq!(rollout.take_over(prepared), expected);
            assert_eq!(most(&next(&mut rollout), &alone), 0.0);
        }
    }
}
