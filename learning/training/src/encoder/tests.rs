use image::{Rgb, RgbImage};
use serde_json::Value;
use wm_dataset::testing::write_moves;
use wm_zoo::ModelFolder;

use super::{arguments::train_on, *};
use crate::{
    arguments::tests::run_in,
    recipe::{Span, tests::bundled},
    run::{Learner as _, Stop, tests::expect_same_bytes_after_pause},
};

const SIDE: u32 = 16;
/// Width of the bar in the pictures.
const BAR: u32 = 4;
/// Frames of an episode.
const FRAMES: usize = 12;

/// Episodes of a bar that moves up to three pixels sideways per frame, which is the action.
fn moving_bar(dir: &Path, name: &str, episodes: usize, seed: u64) -> Dataset {
    let mut state = seed;
    // A congruential generator suffices: movements must only differ.
    let mut below = |end: u32| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((state >> 40) as u32) % end
    };
    let bags = dir.join(name);
    for episode in 0..episodes {
        let mut at = below(SIDE - BAR + 1);
        let frames: Vec<_> = (0..FRAMES)
            .map(|_| {
                let picture = RgbImage::from_fn(SIDE, SIDE, |x, _| match x.checked_sub(at) {
                    Some(0..BAR) => Rgb([220, 40, 30]),
                    _ => Rgb([90, 90, 90]),
                });
                let next = (at + below(7)).saturating_sub(3).min(SIDE - BAR);
                // Model units of the action cover -1 to 1.
                let dx = (f64::from(next) - f64::from(at)) / 3.0 / 35.0;
                at = next;
                (picture, dx as f32)
            })
            .collect();
        write_moves(&bags.join(format!("episode_{episode}")), frames);
    }
    Dataset::open(&bags, &dir.join("cache"), (SIDE as usize, SIDE as usize)).unwrap()
}

/// A small recipe for these episodes, with one camera frame per model step.
fn small(others: &[&str]) -> EncoderRecipe {
    let settings = [
        "batch=8",
        "micro_batch=4",
        "windows=2",
        "model.name=bars",
        "model.image=16",
        "model.patch=4",
        "model.hidden=32",
        "model.depth=1",
        "model.heads=2",
        "head.patch=2",
        "head.hidden=32",
        "head.width=8",
        "head.depth=2",
        "head.heads=2",
        "head.mlp=64",
        "head.frame_skip=1",
        "optimisation.ema_decay=0.9",
    ];
    bundled("tiny", &[&settings, others].concat())
}

fn trained(run: &RunArgs, recipe: &EncoderRecipe, data: (&Dataset, Option<&Dataset>)) {
    train_on(run, recipe, data, &Stop::default()).unwrap();
}

fn description(out: &Path) -> Value {
    let text = std::fs::read_to_string(out.join(folder::FILE)).unwrap();
    serde_json::from_str(&text).unwrap()
}

#[test]
fn features_encode_actions_of_unseen_episodes() {
    let dir = tempfile::tempdir().unwrap();
    let train = moving_bar(dir.path(), "train", 40, 1);
    let held_out = moving_bar(dir.path(), "held_out", 8, 2);
    let out = dir.path().join("run");
    let recipe = small(&[
        "length=1000 steps",
        "validate_every=1000",
        "optimisation.learning_rate=2e-3",
    ]);
    trained(&run_in(&out), &recipe, (&train, Some(&held_out)));
    let journal = std::fs::read_to_string(out.join("encoder.journal.jsonl")).unwrap();
    let last: Value = serde_json::from_str(journal.lines().last().unwrap()).unwrap();
    println!("{last}");
    let r = last["validation"]["r_translation"].as_f64().unwrap();
    assert!(r > 0.8, "{last}");
}

#[test]
fn paused_training_gives_the_same_bytes_for_any_threads() {
    let dir = tempfile::tempdir().unwrap();
    let data = moving_bar(dir.path(), "bags", 3, 1);
    let mut recipe = small(&["optimisation.final_rate=1", "head.horizon=2"]);
    let train = |out: &Path, steps| {
        recipe.length = Span::Steps(steps);
        let run = RunArgs {
            threads: Some(if steps == 2 { 1 } else { 2 }),
            ..run_in(out)
        };
        trained(&run, &recipe, (&data, None));
    };
    let files = [FILE, folder::FILE, "encoder.checkpoint.safetensors"];
    expect_same_bytes_after_pause(dir.path(), &files, [2, 4], train);
}

#[test]
fn output_model_has_the_trained_features() {
    let dir = tempfile::tempdir().unwrap();
    let data = moving_bar(dir.path(), "bags", 2, 1);
    let recipe = small(&[]);
    let encoding = recipe.head.encoding(data.action_space()).unwrap();
    let out = dir.path().join("run");
    std::fs::create_dir(&out).unwrap();
    let on = (&data, None);
    let mut task =
        EncoderTask::new(&recipe, recipe.config(), &encoding, on, &run_in(&out)).unwrap();
    // Changed weights, as after a step.
    let mut parameters = task.parameters().unwrap();
    for value in parameters.iter_mut().flat_map(|p| &mut p.values) {
        *value = *value * 1.5 + 0.01;
    }
    let weights = || {
        parameters.iter().map(|parameter| ParameterValues {
            name: &parameter.name,
            shape: &parameter.shape,
            values: &parameter.values,
        })
    };
    task.assign(&mut weights()).unwrap();
    task.write(&mut weights(), &out).unwrap();

    let folder = ModelFolder::open(out.to_str().unwrap()).unwrap();
    let encoder = folder.encoder().unwrap();
    assert_eq!(encoder.space().name, "bars");
    assert_eq!(encoder.space().shape(), (4, 4, 32));
    let (pictures, _) = task.clips.tensors(&task.clips.all()).unwrap();
    let expected = task.network.features(&pictures).unwrap();
    let found = each_frame(&pictures, |pictures| Ok(encoder.encode(pictures)?)).unwrap();
    let error = (found - &expected)
        .unwrap()
        .abs()
        .unwrap()
        .max_all()
        .unwrap();
    let error = error.to_scalar::<f32>().unwrap();
    let most = expected.abs().unwrap().max_all().unwrap();
    let most = most.to_scalar::<f32>().unwrap();
    println!("differs by {error:.1e} of at most {most:.1}");
    // Weights have 11 bits, and rounding errors accumulate over the layers.
    assert!(most > 1.0 && error < 1e-2 * most, "{error} of {most}");
}

#[test]
fn fine_tuning_keeps_the_sizes_of_its_encoder() {
    let dir = tempfile::tempdir().unwrap();
    let data = moving_bar(dir.path(), "bags", 2, 1);
    let (first, second) = (dir.path().join("first"), dir.path().join("second"));
    let short = small(&["length=1 steps"]);
    trained(&run_in(&first), &short, (&data, None));
    let other = small(&["length=1 steps", "model.hidden=64", "head.hidden=16"]);
    let run = RunArgs {
        from: Some(first.display().to_string()),
        ..run_in(&second)
    };
    trained(&run, &other, (&data, None));
    assert_eq!(description(&first), description(&second));
}

#[test]
fn encoder_starts_close_to_its_patches() {
    let dir = tempfile::tempdir().unwrap();
    let data = moving_bar(dir.path(), "bags", 2, 1);
    let recipe = small(&["model.depth=4"]);
    let encoding = recipe.head.encoding(data.action_space()).unwrap();
    let run = run_in(dir.path());
    let task = EncoderTask::new(&recipe, recipe.config(), &encoding, (&data, None), &run).unwrap();
    let grey = vec![0.4_f32; 16 * 16 * 3];
    let mut lit = grey.clone();
    // The second patch of the first row.
    for row in 0..4 {
        lit[(row * 16 + 4) * 3..(row * 16 + 8) * 3].fill(0.9);
    }
    let pictures = Tensor::from_vec([grey, lit].concat(), (1, 2, 16, 16, 3), &Device::Cpu);
    let features = task.network.features(&pictures.unwrap()).unwrap();
    let features = features.reshape((2, 16, 32)).unwrap();
    let change = (features.get(1).unwrap() - features.get(0).unwrap()).unwrap();
    let change = change.sqr().unwrap().mean(1).unwrap();
    let change: Vec<f32> = change.to_vec1().unwrap();
    let elsewhere = (change.iter().sum::<f32>() - change[1]) / 15.0;
    println!("{} there, {elsewhere} elsewhere", change[1]);
    // Features have variance 1; with full blocks, the change would be 0.69.
    assert!(change[1] > 1.5 && elsewhere < 0.05 * change[1]);
}

#[test]
fn windows_are_successive_frames_of_one_clip() {
    let clips = Tensor::from_vec(
        vec![0_u32, 1, 2, 3, 10, 11, 12, 13],
        (2, 4, 1),
        &Device::Cpu,
    );
    let found = windows(&clips.unwrap(), 3).unwrap();
    let found = found.squeeze(2).unwrap().to_vec2::<u32>().unwrap();
    assert_eq!(found, [[0, 1, 2], [10, 11, 12], [1, 2, 3], [11, 12, 13]]);
}

#[test]
fn unsuitable_settings_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let data = moving_bar(dir.path(), "bags", 1, 1);
    for (setting, named) in [
        ("micro_batch=3", "micro_batch 3"),
        ("windows=0", "windows is 0"),
        ("dropout=1", "dropout is 1"),
        ("light=-0.1", "light is -0.1"),
        ("model.patch=5", "model.patch, 5"),
        ("model.heads=3", "model.heads, 3"),
        ("head.patch=3", "head: patch is 3"),
        ("head.heads=3", "head"),
        ("head.horizon=12", "14 frames"),
        ("model.name=null", "model.name"),
    ] {
        let recipe = small(&[setting, "length=1 steps", "head.kind=transformer"]);
        let run = run_in(&dir.path().join(setting));
        let error = train_on(&run, &recipe, (&data, None), &Stop::default()).unwrap_err();
        let message = format!("{error:#}");
        assert!(message.contains(named), "{setting}: {message}");
    }
}
