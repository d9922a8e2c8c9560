use super::{arguments::train_on, *};
use crate::{
    arguments::tests::run_in,
    recipe::{self, Override, Span},
    run::Stop,
    transition::tests::{labelled, moving},
};

fn small(name: &str, steps: u64) -> ProbeRecipe {
    let settings = [
        "batch=8",
        "micro_batch=4",
        "model.pool=2",
        "model.hidden=32",
        "model.depth=1",
    ];
    let others = [
        "model.heads=2",
        "model.ffn=48",
        "model.text_features=16",
        "model.frame_skip=1",
    ];
    let more = [
        "optimisation.ema_decay=0.9",
        "optimisation.learning_rate=3e-3",
        "validate_every=50",
    ];
    let settings = settings.iter().chain(&others).chain(&more);
    let settings: Vec<Override> = settings.map(|setting| setting.parse().unwrap()).collect();
    ProbeRecipe {
        length: Span::Steps(steps),
        ..recipe::load(RECIPES, name, &settings).unwrap()
    }
}

/// Episodes that succeed if their level ended on the side that the instruction names.
#[test]
fn it_learns_what_an_instruction_asks_for() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (labelled(dir.path(), 200, 1), labelled(dir.path(), 40, 2));
    let recipe = small("tiny", 400);
    let stop = Stop::default();
    train_on(&run_in(dir.path()), &recipe, &train, Some(&held_out), &stop).unwrap();
    let weights = Weights::open(dir.path().join(FILE)).unwrap();
    let episodes = Episodes::new(&held_out, 1, None);
    let found = accuracy(&weights, &episodes, usize::MAX).unwrap();
    println!("{found}");
    assert!(found.balanced > 0.8, "{found}");
    assert!(found.mismatches.unwrap() > 0.8, "{found}");
    // What was kept is the best of all validations.
    let kept: Accuracy = weights.json(VALIDATION_KEY).unwrap();
    assert!(
        (kept.balanced - found.balanced).abs() < 1e-9,
        "{kept} {found}"
    );
}

#[test]
fn a_paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (labelled(dir.path(), 12, 1), labelled(dir.path(), 12, 2));
    for name in ["tiny", "paper"] {
        let run = |out: &Path, steps| {
            let mut recipe = small(name, steps);
            // With a learning rate that does not depend on the length, it makes no difference where a run paused.
            recipe.optimisation.final_rate = 1.0;
            recipe.validate_every = 2;
            let run = run_in(out);
            train_on(&run, &recipe, &train, Some(&held_out), &Stop::default()).unwrap();
        };
        let (whole, parts) = (
            dir.path().join(name),
            dir.path().join(format!("{name} parts")),
        );
        run(&whole, 4);
        run(&parts, 2);
        run(&parts, 4);
        for file in [FILE, "probe.checkpoint.safetensors"] {
            let read = |out: &Path| std::fs::read(out.join(file)).unwrap();
            assert!(read(&whole) == read(&parts), "{name}: {file}");
        }
    }
}

#[test]
fn data_without_outcomes_are_refused_by_what_they_lack() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let run = run_in(dir.path());
    let error = train_on(&run, &small("tiny", 1), &latents, None, &Stop::default()).unwrap_err();
    assert!(error.to_string().contains("/task/success"), "{error}");
}

#[test]
fn cross_entropy_is_that_of_the_probability() {
    let logit = Tensor::new(&[-2.0f32, 0.5, 90.0], &Device::Cpu).unwrap();
    for answer in [true, false] {
        let found = cross_entropy(&logit, answer)
            .unwrap()
            .to_vec1::<f32>()
            .unwrap();
        for (logit, found) in [-2.0f64, 0.5, 90.0].into_iter().zip(found) {
            let signed = if answer { logit } else { -logit };
            let expected = (1.0 + (-signed).exp()).ln();
            assert!((f64::from(found) - expected).abs() < 1e-5 * expected.max(1.0));
        }
    }
}
