use super::*;
use crate::transition::{LoadedTransition, NewFrame};

fn waves(count: usize, step: f32) -> Vec<f32> {
    (0..count).map(|i| (i as f32 * step).sin()).collect()
}

/// Products and attention in bf16, as a GPU does them, after frames that candidates share and frames of their own.
#[test]
fn weights_of_sixteen_bits_give_about_the_same() {
    for wide_head in [None, Some(48)] {
        let config = TransitionConfig {
            wide_head,
            ..TransitionConfig::preset("tiny", (4, 4, 4), 2, 7).unwrap()
        };
        let exact = Transition::random(config.clone(), 1).unwrap();
        let rounded = Transition::build(config, &mut |parameter| {
            Ok(parameter.sample(1)?.to_dtype(DType::BF16)?)
        });
        let rounded = TensorTransition::new(rounded.unwrap(), true).unwrap();
        assert!(rounded.place().ends_with("bf16"), "{}", rounded.place());
        let [found, expected] = [rounded.into(), exact.pack().unwrap()].map(two_predicted);
        let norm = |x: &mut dyn Iterator<Item = f32>| x.map(|v| v * v).sum::<f32>().sqrt();
        let mut differences = found.iter().zip(&expected).map(|(a, b)| a - b);
        let difference = norm(&mut differences) / norm(&mut expected.iter().copied());
        // Weights, inputs and outputs of every product have eight bits, 0.2 % each, and ten layers follow each other.
        assert!((1e-3..5e-2).contains(&difference), "{difference}");
    }
}

/// The outputs of two candidates at the second of two frames of their own, after one that they share.
fn two_predicted(model: LoadedTransition) -> Vec<f32> {
    let (one, two) = (waves(64, 0.3), waves(128, 0.7));
    let action = waves(14, 0.9);
    let frame = |latents, tau, action| NewFrame {
        latents,
        tau,
        action,
    };
    let shared = model.pass(&[], &[frame(&one, &[0.1], &action[..7])], 1, 1);
    let mut contexts = shared.unwrap().contexts;
    let own = frame(&two, &[0.1, 0.1], &action);
    let earlier: Vec<_> = contexts.iter().collect();
    let kept = model.pass(&earlier, &[own], 1, 1).unwrap().contexts;
    contexts.extend(kept);
    let earlier: Vec<_> = contexts.iter().collect();
    let last = frame(&two, &[0.9, 0.4], &action);
    model
        .pass(&earlier, &[last], 0, 0)
        .unwrap()
        .outputs
        .concat()
}
