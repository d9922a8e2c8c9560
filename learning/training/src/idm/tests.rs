use candle_core::Device;

use super::{arguments::train_on, *};
use crate::{
    arguments::tests::run_in,
    recipe::{Span, tests::bundled},
    run::{Stop, tests::expect_same_bytes_after_pause},
    transition::tests::{moving, of_space},
};

/// A small recipe for the episodes of [`moving`], with one camera frame per model step.
fn small(name: &str) -> IdmRecipe {
    let settings = [
        "batch=8",
        "micro_batch=4",
        "model.patch=2",
        "model.hidden=32",
        "model.width=8",
        "model.depth=1",
        "model.heads=2",
        "model.frame_skip=1",
        "dropout=0.05",
        "optimisation.ema_decay=0.9",
    ];
    bundled(name, &settings)
}

/// A briefly trained model for these latents.
pub(crate) fn trained(out: &Path, latents: &Latents) -> TrainedIdm {
    let mut recipe = small("tiny");
    recipe.length = Span::Steps(30);
    train_on(&run_in(out), &recipe, latents, None, &Stop::default()).unwrap();
    TrainedIdm::open(out.join(FILE)).unwrap()
}

#[test]
fn training_learns_visible_actions() {
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (moving(dir.path(), 200, 1), moving(dir.path(), 30, 2));
    for (kind, steps) in [(IdmKind::Convolutional, 300), (IdmKind::Transformer, 1000)] {
        let mut recipe = small("tiny");
        recipe.length = Span::Steps(steps);
        recipe.model.kind = kind;
        let out = dir.path().join(format!("{kind:?}"));
        let stop = Stop::default();
        train_on(&run_in(&out), &recipe, &train, Some(&held_out), &stop).unwrap();
        let model = TrainedIdm::open(out.join(FILE)).unwrap();
        let found = on_real(&model, &held_out, usize::MAX).unwrap();
        println!("{kind:?}: {found}");
        // The other dimensions are constant.
        assert_eq!(found.continuous.len(), 1, "{found}");
        let (name, kind, r) = found.continuous.first().unwrap();
        assert_eq!(
            (name.as_str(), *kind),
            ("dx", wm_motion::actions::Kind::TranslationDelta)
        );
        assert!(*r > 0.8, "{found}");
        assert_eq!(found.gripper, Some(1.0));
    }
}

/// A model of single steps takes the whole way to a far goal for one action; one of far goals knows that it is several.
#[test]
fn far_goals_teach_the_first_action_of_the_way() {
    const STEPS: usize = 4;
    let dir = tempfile::tempdir().unwrap();
    let (train, held_out) = (moving(dir.path(), 200, 1), moving(dir.path(), 30, 2));
    let of = |longest: usize, last_goals: f64| {
        let mut recipe = small("tiny");
        recipe.length = Span::Steps(300);
        (recipe.longest, recipe.last_goals) = (longest, last_goals);
        let out = dir.path().join(format!("{longest} {last_goals}"));
        train_on(&run_in(&out), &recipe, &train, None, &Stop::default()).unwrap();
        TrainedIdm::open(out.join(FILE)).unwrap()
    };
    let recipe = small("tiny");
    let encoding = recipe.model.encoding(held_out.action_space()).unwrap();
    let clips = ClipSource::new(&held_out, &encoding, STEPS + 1).unwrap();
    let (latents, actions) = clips.tensors(&clips.all()).unwrap();
    let ends = [0, STEPS].map(|frame| latents.narrow(1, frame, 1).unwrap());
    let pairs = Tensor::cat(&ends, 1).unwrap();
    let truth = actions.narrow(1, 0, 1).unwrap().narrow(2, 0, 1).unwrap();
    let error = |model: TrainedIdm| {
        let found = model
            .idm()
            .forward(&pairs)
            .unwrap()
            .narrow(2, 0, 1)
            .unwrap();
        let error = (found - &truth).unwrap().sqr().unwrap().mean_all().unwrap();
        error.to_scalar::<f32>().unwrap()
    };
    let [near, far, last] = [(1, 0.0), (STEPS, 0.0), (STEPS, 1.0)].map(|(a, b)| error(of(a, b)));
    assert!(far < 0.9 * near, "{far} and {near}");
    assert!(last < 0.9 * near && last != far, "{last} and {near}");
    let refused = |longest, horizon, last_goals| {
        let mut recipe = small("tiny");
        (recipe.longest, recipe.model.horizon) = (longest, horizon);
        recipe.last_goals = last_goals;
        let out = run_in(dir.path());
        let error = train_on(&out, &recipe, &train, None, &Stop::default());
        error.unwrap_err().to_string()
    };
    for (settings, named) in [
        ((4, 2, 0.0), "horizon of 1"),
        ((4, 1, 1.5), "0 to 1"),
        ((1, 1, 0.5), "longest above 1"),
    ] {
        let error = refused(settings.0, settings.1, settings.2);
        assert!(error.contains(named), "{error}");
    }
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 4, 1);
    for name in ["tiny", "paper"] {
        let mut recipe = small(name);
        recipe.optimisation.final_rate = 1.0;
        recipe.model.horizon = 2;
        let train = |out: &Path, steps| {
            recipe.length = Span::Steps(steps);
            train_on(&run_in(out), &recipe, &latents, None, &Stop::default()).unwrap();
        };
        let files = [FILE, "idm.checkpoint.safetensors"];
        expect_same_bytes_after_pause(&dir.path().join(name), &files, [2, 4], train);
    }
}

#[test]
fn latents_of_another_space_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let recipe = IdmRecipe {
        length: Span::Steps(1),
        ..small("tiny")
    };
    train_on(
        &run_in(dir.path()),
        &recipe,
        &latents,
        None,
        &Stop::default(),
    )
    .unwrap();
    let model = TrainedIdm::open(dir.path().join(FILE)).unwrap();
    assert_eq!(model.space(), latents.space());
    let other = of_space(dir.path(), 2, 3, "another");
    let error = on_real(&model, &other, 1).unwrap_err().to_string();
    assert!(error.contains("another"), "{error}");
}

#[test]
fn smooth_l1_matches_pytorch() {
    let on = &Device::Cpu;
    let found = Tensor::new(&[0.0f32, 0.5, 3.0, -2.0], on).unwrap();
    let truth = Tensor::new(&[0.0f32, 0.0, 1.0, 0.0], on).unwrap();
    let loss = smooth_l1(&found, &truth)
        .unwrap()
        .to_scalar::<f32>()
        .unwrap();
    assert!((loss - (0.125 + 1.5 + 1.5) / 4.0).abs() < 1e-6, "{loss}");
}
