use std::path::Path;

use half::f16;
use wm_dataset::Episode;
use wm_model::{
    Compute, Kernels, LatentSpace, NumberFormat,
    transition::{ActionAlignment, Parametrisation},
};
use wm_motion::actions::{Accumulation, ActionSpace};

use super::*;
use crate::{
    arguments::tests::run_in,
    optimiser::{AdamW, AdamWSettings, Schedule, Variables},
    recipe::{Span, tests::bundled},
    run::{StepLoss, tests::expect_same_bytes_after_pause},
    workers::{Batches, Workers},
};

/// [`super::train_on`] in one process.
pub(crate) fn train_on(
    run: &RunArgs,
    recipe: &TransitionRecipe,
    from: Option<TransitionTensors>,
    train: &Latents,
    held_out: Option<(&Latents, Option<Pictures<'_>>)>,
    stop: &Stop,
) -> Result<RunEnd> {
    let alone = ListenArgs::default();
    super::train_on(run, recipe, from, (train, None), held_out, (&alone, stop))
}

const SIDE: usize = 4;
const CHANNELS: usize = 2;
const FRAMES: usize = 12;

/// Episodes in which dx moves the whole first channel, visible only in the action.
pub(crate) fn moving(dir: &Path, episodes: usize, seed: u64) -> Latents {
    of_space(dir, episodes, seed, "moving")
}

/// [`moving`] with a second channel of -1 or 1 in each frame, at random.
pub(crate) fn flickering(dir: &Path, episodes: usize, seed: u64) -> Latents {
    latents(dir, episodes, seed, "flickering", (false, true))
}

/// [`moving`] with an instruction and an outcome: whether the level ends on the side in the instruction.
pub(crate) fn labelled(dir: &Path, episodes: usize, seed: u64) -> Latents {
    latents(dir, episodes, seed, "moving", (true, false))
}

/// [`moving`] in a latent space of this name.
pub(crate) fn of_space(dir: &Path, episodes: usize, seed: u64, name: &str) -> Latents {
    latents(dir, episodes, seed, name, (false, false))
}

/// [`moving`] for another robot with one action value.
fn with_actions(dir: &Path, episodes: usize, space: ActionSpace) -> Latents {
    let whole = moving(dir, episodes, 1);
    let mut list = whole.episodes().to_vec();
    for action in list.iter_mut().flat_map(|episode| &mut episode.actions) {
        action.truncate(1);
    }
    let file = dir.join("latents 1");
    Latents::map(&file, whole.space().clone(), list, "other".into(), space).unwrap()
}

fn latents(
    dir: &Path,
    episodes: usize,
    seed: u64,
    name: &str,
    (is_labelled, flickers): (bool, bool),
) -> Latents {
    latents_of_width(dir, episodes, seed, name, (is_labelled, flickers), SIDE)
}

fn latents_of_width(
    dir: &Path,
    episodes: usize,
    seed: u64,
    name: &str,
    (is_labelled, flickers): (bool, bool),
    width: usize,
) -> Latents {
    let mut bytes = Vec::new();
    let mut list = Vec::new();
    let mut state = seed;
    for index in 0..episodes {
        let (mut level, mut last) = (0.0_f32, 0.0);
        let mut actions = Vec::new();
        for _ in 0..FRAMES {
            for place in 0..SIDE * width {
                let second = match flickers {
                    true => ((state >> 33) % 2) as f32 * 2.0 - 1.0,
                    false => (place + index) as f32 * 0.1,
                };
                for value in [level, second] {
                    bytes.extend(f16::from_f32(value).to_le_bytes());
                }
            }
            // A congruential generator suffices: actions must only differ.
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let step = (state >> 40) as f32 / (1 << 24) as f32 * 2.0 - 1.0;
            last = level;
            level += step;
            actions.push(vec![step / 35.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        }
        list.push(Episode {
            name: format!("episode {index}"),
            first_frame: index * FRAMES,
            frame_count: FRAMES,
            actions,
            instruction: is_labelled
                .then(|| format!("go {}", if index % 2 == 0 { "up" } else { "down" })),
            success: is_labelled.then_some((last > 0.0) == (index % 2 == 0)),
            ..Episode::default()
        });
    }
    let path = dir.join(format!("latents {seed}"));
    std::fs::write(&path, bytes).unwrap();
    let space = LatentSpace {
        name: name.into(),
        hash: name.into(),
        height: SIDE,
        width,
        channels: CHANNELS,
    };
    Latents::map(&path, space, list, "digest".into(), ActionSpace::bridge()).unwrap()
}

pub(crate) fn encoding() -> ActionEncoding {
    ActionEncoding::new(ActionSpace::bridge(), 7, 1, Accumulation::Mean).unwrap()
}

pub(crate) fn config(
    parametrisation: Parametrisation,
    action_alignment: ActionAlignment,
) -> TransitionConfig {
    TransitionConfig {
        hidden: 32,
        depth: 1,
        heads: 2,
        max_frames: 5,
        frame_skip: 1,
        parametrisation,
        action_alignment,
        ..TransitionConfig::preset("tiny", (SIDE, SIDE, CHANNELS), 2, 7).unwrap()
    }
}

fn tiny() -> TransitionRecipe {
    bundled("tiny", &[])
}

pub(super) fn objective(forcing: Forcing) -> Objective {
    Objective {
        clips: 8,
        micro_batch: 2,
        shift: 3.0,
        seed: 1,
        recipe: ObjectiveRecipe {
            forcing,
            history_noise: 0.05,
            own_history: match forcing {
                Forcing::Teacher => 0.25,
                Forcing::Diffusion => 0.0,
            },
            ..tiny().objective
        },
    }
}

pub(super) fn fresh(config: &TransitionConfig, seed: u64) -> (Variables, Transition) {
    let weights = FreshWeights::new(seed);
    let model = trainable(config, &weights, seed).unwrap();
    (weights.into_variables().0, model)
}

fn step(
    workers: &Workers,
    (variables, model): &(Variables, Transition),
    clips: &ClipSource<'_>,
    objective: &Objective,
    step: u64,
) -> StepLoss {
    let batches = Batches {
        count: 4,
        seed: objective.seed,
        step,
    };
    let loss = |rng: &mut _| {
        let gradients = WeightGradients::default();
        let loss = objective.loss(&model.collecting(&gradients), (clips, None), rng)?;
        Ok(BatchLoss {
            gradients,
            ..BatchLoss::from(loss)
        })
    };
    workers.step(variables, batches, &loss).unwrap()
}

#[test]
fn step_does_not_depend_on_the_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 4, 1);
    let encoding = encoding();
    let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
    let config = config(Parametrisation::Residual, ActionAlignment::WithResult);
    let trained = fresh(&config, 3);
    let run = |threads: usize| {
        let workers = Workers::new(threads).unwrap();
        step(&workers, &trained, &clips, &objective(Forcing::Teacher), 7)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn training_learns_the_effect_of_actions() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 24, 1);
    let held_out = moving(dir.path(), 6, 2);
    let encoding = encoding();
    use {ActionAlignment::*, Forcing::*, Parametrisation::*};
    for (predicts, alignment, forcing, steps) in [
        (Residual, WithResult, Teacher, 150),
        (Residual, WithFrame, Teacher, 150),
        (Velocity, WithResult, Teacher, 400),
        (Velocity, WithFrame, Diffusion, 400),
    ] {
        let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
        let trained = fresh(&config(predicts, alignment), 3);
        let workers = Workers::new(2).unwrap();
        let parameters = trained.0.parameters(|_| 0).unwrap();
        let mut optimiser = AdamW::new(parameters, AdamWSettings::default());
        let schedule = Schedule::new(4e-3, 10, steps, 0.05);
        for index in 0..steps {
            let found = step(&workers, &trained, &clips, &objective(forcing), index);
            optimiser.step(&found.gradient, schedule.at(index)).unwrap();
            trained.0.assign(optimiser.weights()).unwrap();
        }
        let model = trained.1;
        let evaluation = Windows::new(&held_out, &encoding, 3, usize::MAX).unwrap();
        let model = model.pack().unwrap();
        let ratio = |change| evaluation.ratios(&model, change).unwrap()[0];
        let (told, negated) = (ratio(ActionChange::None), ratio(ActionChange::Negated));
        println!("{predicts:?} {alignment:?} {forcing:?}: {told:.3}, negated {negated:.3}");
        assert!(told < 0.4, "{predicts:?} {alignment:?} {forcing:?}: {told}");
        assert!(
            negated > 1.5,
            "{predicts:?} {alignment:?} {forcing:?}: {negated}"
        );
    }
}

/// Weights are rounded only for products: the optimiser keeps changes too small for eight bits.
#[test]
fn bf16_training_learns_like_f32() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 12, 1);
    let encoding = encoding();
    let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
    let config = config(Parametrisation::Residual, ActionAlignment::WithResult);
    let workers = Workers::new(2).unwrap();
    let [exact, rounded] = [NumberFormat::F32, NumberFormat::Bf16].map(|format| {
        let compute = Compute::on_cpu(Kernels::Candle);
        let compute = compute.with_format(format).unwrap();
        let fresh = FreshWeights::new(3).on(&compute).unwrap();
        let model = trainable(&config, &fresh, 3).unwrap();
        let trained = (fresh.into_variables().0, model);
        let parameters = trained.0.parameters(|_| 0).unwrap();
        let mut optimiser = AdamW::new(parameters, AdamWSettings::default());
        let losses: Vec<f32> = (0..60)
            .map(|index| {
                let found = step(
                    &workers,
                    &trained,
                    &clips,
                    &objective(Forcing::Teacher),
                    index,
                );
                optimiser.step(&found.gradient, 4e-3).unwrap();
                trained.0.assign(optimiser.weights()).unwrap();
                found.loss
            })
            .collect();
        let is_fine = |value: &f32| half::bf16::from_f32(*value).to_f32() != *value;
        assert!(optimiser.weights().any(|w| w.values.iter().any(is_fine)));
        let last = &losses[50..];
        (losses[0], last.iter().sum::<f32>() / last.len() as f32)
    });
    println!("f32: {exact:?}, bf16: {rounded:?}");
    assert!(exact.1 < 0.7 * exact.0, "{exact:?}");
    assert!(
        (rounded.1 / exact.1 - 1.0).abs() < 0.1,
        "{exact:?} {rounded:?}"
    );
}

#[test]
fn episodes_shorter_than_a_clip_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let encoding = ActionEncoding::default();
    let error = ClipSource::new(&latents, &encoding, 8)
        .map(|_| ())
        .unwrap_err();
    assert!(error.to_string().contains("15 frames"), "{error}");
    assert_eq!(
        ClipSource::new(&latents, &encoding, 6).unwrap().all().len(),
        2
    );
}

/// The recipe `name` for a model that trains quickly.
pub(crate) fn small(name: &str, shift: Option<f64>) -> TransitionRecipe {
    let recipe: TransitionRecipe = bundled(name, &[]);
    TransitionRecipe {
        length: Span::Steps(3),
        batch: 2,
        micro_batch: 2,
        model: ModelRecipe {
            hidden: Some(32),
            depth: Some(1),
            heads: Some(2),
            frames: 5,
            patch: Some(2),
            ..recipe.model
        },
        sampler: SamplerRecipe {
            shift,
            ..recipe.sampler
        },
        ..recipe
    }
}

#[test]
fn training_and_sampling_use_the_same_shift() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    // The published shift for latents this small is 1.
    for (name, shift, expected) in [
        ("paper", None, 1.0),
        ("paper", Some(3.0), 3.0),
        ("tiny", None, 16.0),
    ] {
        let recipe = small(name, shift);
        let encoding = recipe.encoding(latents.action_space()).unwrap();
        let config = recipe.config(latents.space(), &encoding).unwrap();
        assert_eq!(recipe.objective(&config).unwrap().shift, expected, "{name}");
        let out = dir.path().join(format!("{name} {expected}"));
        train_on(
            &run_in(&out),
            &recipe,
            None,
            &latents,
            None,
            &Stop::default(),
        )
        .unwrap();
        let written = Weights::open(out.join(FILE)).unwrap();
        let written: TransitionConfig = written.json(CONFIG_KEY).unwrap();
        assert_eq!(written.sampler.shift, expected, "{name}");
    }
}

#[test]
fn paused_training_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    for name in ["paper", "tiny"] {
        let mut recipe = small(name, None);
        recipe.optimisation.final_rate = 1.0;
        let train = |out: &Path, steps| {
            recipe.length = Span::Steps(steps);
            let run = run_in(out);
            train_on(&run, &recipe, None, &latents, None, &Stop::default()).unwrap();
        };
        let files = [FILE, "transition.checkpoint.safetensors"];
        expect_same_bytes_after_pause(&dir.path().join(name), &files, [2, 4], train);
    }
}

#[test]
fn contradictory_settings_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    let refused = |change: &dyn Fn(&mut TransitionRecipe)| {
        let mut recipe = small("tiny", None);
        change(&mut recipe);
        let out = dir.path().join("refused");
        let error = train_on(
            &run_in(&out),
            &recipe,
            None,
            &latents,
            None,
            &Stop::default(),
        );
        format!("{:#}", error.unwrap_err())
    };
    let error = refused(&|recipe| recipe.objective.forcing = Forcing::Diffusion);
    assert!(error.contains("model.predicts must be velocity"), "{error}");
    let error = refused(&|recipe| recipe.objective.action_dropout = 0.1);
    assert!(error.contains("model.null_action"), "{error}");
    let error = refused(&|recipe| recipe.micro_batch = 3);
    assert!(error.contains("micro_batch 3"), "{error}");
}

/// Fine-tuning on other actions keeps the parts that do not depend on them, at a lower learning rate.
#[test]
fn model_is_fine_tuned_to_other_actions() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 4, 1);
    let (first, second) = (dir.path().join("first"), dir.path().join("second"));
    let recipe = small("tiny", None);
    train_on(
        &run_in(&first),
        &recipe,
        None,
        &latents,
        None,
        &Stop::default(),
    )
    .unwrap();
    let from = ModelFolder::open(first.to_str().unwrap()).unwrap();
    let from = from.transition_tensors().unwrap();
    let joint = r#"{"name": "elbow", "unit": "rad", "kind": "joint_delta"}"#;
    let space = format!(r#"{{"name": "one_joint", "rate": 5.0, "dimensions": [{joint}]}}"#);
    let other = with_actions(dir.path(), 4, serde_json::from_str(&space).unwrap());
    let mut recipe = small("tiny", None);
    recipe.optimisation.learning_rate = 0.0;
    recipe.model.frame_skip = 1;
    let run = RunArgs {
        from: Some(first.display().to_string()),
        set: vec!["model.frame_skip=1".parse().unwrap()],
        ..run_in(&second)
    };
    train_on(&run, &recipe, Some(from), &other, None, &Stop::default()).unwrap();
    let tuned = ModelFolder::open(second.to_str().unwrap()).unwrap();
    let tuned = tuned.transition_tensors().unwrap();
    assert_eq!((tuned.config.action_dim, tuned.config.hidden), (1, 32));
    let frames = (tuned.config.frame_skip, tuned.encoding.frame_skip());
    assert_eq!(frames, (1, 1), "as set, not as in the old model");
    // Without a learning rate, fine-tuned weights stay unchanged.
    let old = Weights::open(first.join(FILE)).unwrap();
    for (name, tensor) in &tuned.tensors {
        let values = tensor.flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let same = old
            .values(name, tensor.dims())
            .is_ok_and(|old| old == values);
        assert_eq!(same, name != "action_embedder.weight", "{name}");
    }
    let error = train_on(
        &run_in(&second),
        &recipe,
        None,
        &other,
        None,
        &Stop::default(),
    );
    let error = format!("{:#}", error.unwrap_err());
    assert!(error.contains("from"), "{error}");
}

#[test]
fn added_blocks_do_not_change_the_predictions_at_first() {
    let dir = tempfile::tempdir().unwrap();
    let (shallow, deep) = (dir.path().join("shallow"), dir.path().join("deep"));
    let stop = Stop::default();
    let recipe = small("tiny", None);
    let latents = moving(dir.path(), 4, 1);
    train_on(&run_in(&shallow), &recipe, None, &latents, None, &stop).unwrap();

    let from = || {
        let from = ModelFolder::open(shallow.to_str().unwrap()).unwrap();
        from.transition_tensors().unwrap()
    };
    let depth = |depth| {
        let mut recipe = small("tiny", None);
        recipe.optimisation.learning_rate = 0.0;
        recipe.model.depth = Some(depth);
        let run = RunArgs {
            from: Some(shallow.display().to_string()),
            set: vec![format!("model.depth={depth}").parse().unwrap()],
            ..run_in(&deep)
        };
        train_on(&run, &recipe, Some(from()), &latents, None, &stop)
    };
    let error = format!("{:#}", depth(0).unwrap_err());
    assert!(error.contains("model.depth=0"), "{error}");
    depth(3).unwrap();

    let ratios = |folder: &Path| {
        let weights = Weights::open(folder.join(FILE)).unwrap();
        let model = Transition::from_weights(weights).unwrap().pack().unwrap();
        let windows = Windows::new(&latents, &encoding(), 3, usize::MAX).unwrap();
        let depth = model.config().depth;
        (depth, windows.ratios(&model, ActionChange::None).unwrap())
    };
    let ((one, before), (three, after)) = (ratios(&shallow), ratios(&deep));
    assert_eq!((one, three), (1, 3));
    assert!(
        before.iter().all(|ratio| *ratio != 1.0),
        "the model predicts something: {before:?}"
    );
    assert_eq!(before, after);
}

#[test]
fn model_of_one_view_is_fine_tuned_to_two() {
    let dir = tempfile::tempdir().unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    let stop = Stop::default();
    let recipe = small("tiny", None);
    let latents = moving(dir.path(), 4, 1);
    train_on(&run_in(&one), &recipe, None, &latents, None, &stop).unwrap();

    let wide = latents_of_width(dir.path(), 4, 2, "two", (false, false), 2 * SIDE).of_views(2);
    let from = ModelFolder::open(one.to_str().unwrap()).unwrap();
    let from = from.transition_tensors().unwrap();
    let mut recipe = small("tiny", None);
    recipe.optimisation.learning_rate = 0.0;
    let run = RunArgs {
        from: Some(one.display().to_string()),
        ..run_in(&two)
    };
    train_on(&run, &recipe, Some(from), &wide, None, &stop).unwrap();
    let tuned = Weights::open(two.join(FILE)).unwrap();
    let config: TransitionConfig = tuned.json(CONFIG_KEY).unwrap();
    assert_eq!((config.views, config.latent_width), (2, 2 * SIDE));
    let old = Weights::open(one.join(FILE)).unwrap();
    for name in old.names() {
        let shape = old.shape(&name).unwrap();
        assert_eq!(
            old.values(&name, shape).unwrap(),
            tuned.values(&name, shape).unwrap()
        );
    }
    recipe.model.views = Some(3);
    let error = train_on(&run, &recipe, None, &wide, None, &stop).unwrap_err();
    assert!(error.to_string().contains("model.views is 3"), "{error}");
}
