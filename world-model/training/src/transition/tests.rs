use std::path::Path;

use half::f16;
use wm_model::{
    LatentSpace,
    transition::{ActionAlignment, Parametrisation},
};
use wm_motion::actions::{Accumulation, ActionSpace};

use super::*;
use crate::dataset::Episode;

const SIDE: usize = 4;
const CHANNELS: usize = 2;
const FRAMES: usize = 12;

/// Episodes in which dx moves the first channel as a whole, by an amount that nothing but the action tells.
pub(super) fn moving(dir: &Path, episodes: usize, seed: u64) -> Latents {
    let mut bytes = Vec::new();
    let mut list = Vec::new();
    let mut state = seed;
    for index in 0..episodes {
        let mut level = 0.0_f32;
        let mut actions = Vec::new();
        for _ in 0..FRAMES {
            for place in 0..SIDE * SIDE {
                let fixed = (place + index) as f32 * 0.1;
                for value in [level, fixed] {
                    bytes.extend(f16::from_f32(value).to_le_bytes());
                }
            }
            // A congruential generator: all that is needed is that actions differ.
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let step = (state >> 40) as f32 / (1 << 24) as f32 * 2.0 - 1.0;
            level += step;
            actions.push(vec![step / 35.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        }
        list.push(Episode {
            name: format!("episode {index}"),
            first_frame: index * FRAMES,
            frame_count: FRAMES,
            actions,
            ..Episode::default()
        });
    }
    let path = dir.join(format!("latents {seed}"));
    std::fs::write(&path, bytes).unwrap();
    let space = LatentSpace {
        name: "moving".into(),
        hash: "0".into(),
        height: SIDE,
        width: SIDE,
        channels: CHANNELS,
    };
    Latents::map(&path, space, list, "digest".into(), ActionSpace::bridge()).unwrap()
}

pub(super) fn encoding() -> ActionEncoding {
    ActionEncoding::new(ActionSpace::bridge(), 7, 1, Accumulation::Mean).unwrap()
}

pub(super) fn config(
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

pub(super) fn objective() -> Objective {
    Objective {
        clips: 8,
        micro_batch: 2,
        history: 2,
        tau: TauDistribution::Uniform,
        shift: 3.0,
        history_noise: 0.05,
        own_history: 0.25,
        action_dropout: 0.0,
        seed: 1,
    }
}

#[test]
fn a_step_does_not_depend_on_the_number_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 4, 1);
    let encoding = encoding();
    let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
    let config = config(Parametrisation::Residual, ActionAlignment::WithResult);
    let (vars, model) = trainable(&config, 3).unwrap();
    let run = |threads: usize| {
        let workers = Workers::new(threads).unwrap();
        let (loss, gradients) = workers
            .step(&model, &vars, &clips, &objective(), 7)
            .unwrap();
        let gradients: Vec<Vec<f32>> = vars
            .values()
            .map(|var| {
                gradients
                    .get(var)
                    .unwrap()
                    .flatten_all()
                    .unwrap()
                    .to_vec1()
                    .unwrap()
            })
            .collect();
        (loss, gradients)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn it_learns_what_actions_do() {
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 24, 1);
    let held_out = moving(dir.path(), 6, 2);
    let encoding = encoding();
    for (parametrisation, alignment, steps) in [
        (Parametrisation::Residual, ActionAlignment::WithResult, 150),
        (Parametrisation::Residual, ActionAlignment::WithFrame, 150),
        (Parametrisation::Velocity, ActionAlignment::WithResult, 400),
    ] {
        let clips = ClipSource::new(&latents, &encoding, 5).unwrap();
        let (vars, model) = trainable(&config(parametrisation, alignment), 3).unwrap();
        let workers = Workers::new(2).unwrap();
        let mut optimiser = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        let schedule = Schedule::new(4e-3, 10, steps, 0.05);
        for step in 0..steps {
            let (_, gradients) = workers
                .step(&model, &vars, &clips, &objective(), step)
                .unwrap();
            optimiser.step(&gradients, schedule.at(step)).unwrap();
        }
        let evaluation = Evaluation::new(&held_out, &encoding, 3, usize::MAX).unwrap();
        let model = model.pack().unwrap();
        let ratio = |change| evaluation.ratios(&model, change).unwrap()[0];
        let (told, negated) = (ratio(ActionChange::None), ratio(ActionChange::Negated));
        println!("{parametrisation:?} {alignment:?}: {told:.3}, negated {negated:.3}");
        assert!(told < 0.4, "{parametrisation:?} {alignment:?}: {told}");
        assert!(
            negated > 1.5,
            "{parametrisation:?} {alignment:?}: {negated}"
        );
    }
}

#[test]
fn episodes_shorter_than_a_clip_are_refused_by_length() {
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

#[test]
fn a_model_is_trained_at_the_shift_that_its_weights_are_sampled_with() {
    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        train: TrainTransitionArgs,
    }
    let dir = tempfile::tempdir().unwrap();
    let latents = moving(dir.path(), 2, 1);
    // The published shift of latents as small as these is 1.
    for (preset, shift, expected) in [
        ("dit-s", None, 1.0),
        ("dit-s", Some("3"), 3.0),
        ("tiny", None, 16.0),
    ] {
        let out = dir.path().join(format!("{preset} {expected}"));
        let mut line = format!(
            "train --bags=b --autoencoder=a --preset={preset} --hidden=32 --depth=1 --heads=2 --frames=5 --steps=1"
        );
        if let Some(shift) = shift {
            line += &format!(" --shift={shift}");
        }
        let mut arguments: Vec<_> = line.split(' ').map(std::ffi::OsString::from).collect();
        arguments.extend(["--out".into(), out.clone().into()]);
        let args = <Cli as clap::Parser>::parse_from(arguments).train;
        let config = args.config(&latents).unwrap();
        assert_eq!(args.objective(&config).unwrap().shift, expected, "{preset}");
        let encoding = ActionEncoding::default();
        args.train(config, &encoding, &latents, None).unwrap();
        let written = Weights::open(out.join("transition.safetensors")).unwrap();
        let written: TransitionConfig = written.json(CONFIG_KEY).unwrap();
        assert_eq!(written.sampler.shift, expected, "{preset}");
    }
}
