#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use image::Rgb;
use wm_bag::{BagReader, BagWriter, WriterOptions};
use wm_model::{
    Autoencoder, AutoencoderConfig,
    sampler::{Given, Rollout},
    transition::{ActionAlignment, Transition, TransitionConfig},
};
use wm_motion::actions::ActionEncoding;
use wm_msgs::std_msgs;

use super::*;
use wm_model::WorldModel;

use crate::encoder::EncoderStep;
use wm_camera::camera_frame::CameraFrame;

const PERIOD: i64 = 200_000_000;
const STEP: i64 = 2 * PERIOD;
const START: i64 = 1_700_000_000_000_000_000;
/// Frames of the model's window: it slides from the third step on.
const WINDOW: usize = 5;

mod same_moment;

fn world() -> EnvModel {
    world_of(ActionAlignment::WithResult)
}

fn world_of(action_alignment: ActionAlignment) -> EnvModel {
    let config = AutoencoderConfig {
        name: "test".into(),
        height: 32,
        width: 32,
        ..AutoencoderConfig::tiny()
    };
    let autoencoder = || Autoencoder::random(config.clone(), 1).unwrap();
    let space = autoencoder().space().clone();
    let config = TransitionConfig {
        hidden: 64,
        depth: 1,
        heads: 2,
        max_frames: WINDOW,
        action_alignment,
        ..TransitionConfig::preset("tiny", space.shape(), 2, 7).unwrap()
    };
    let predictor = WorldModel {
        transition: Transition::random(config, 3).unwrap().pack().unwrap(),
        name: "test".into(),
        hash: "beef".into(),
        space,
        encoding: ActionEncoding::default(),
    };
    let encoder = EncoderStep::new(Box::new(autoencoder()), LatentDtype::F32);
    EnvModel::new(encoder, predictor, Box::new(autoencoder()), 2, 2)
}

fn env(output: Option<PathBuf>) -> Env {
    env_of(world(), output)
}

fn env_of(world: EnvModel, output: Option<PathBuf>) -> Env {
    Env::new(world, settings(output), Timing::new(PERIOD, 2))
}

fn settings(output: Option<PathBuf>) -> EnvSettings {
    EnvSettings {
        max_episodes: 3,
        max_steps: 50,
        context_frames: 2,
        jpeg_quality: 95,
        instruction: "wait".into(),
        output,
    }
}

fn stamp(ns: i64) -> Time {
    Time::from_nanos(START + ns)
}

fn picture(shade: u8) -> RgbImage {
    RgbImage::from_fn(40, 30, |x, y| Rgb([shade, (x * 6) as u8, (y * 8) as u8]))
}

fn jpeg(shade: u8, stamp: Time) -> CompressedImage {
    let header = Header {
        stamp,
        frame_id: "camera".into(),
    };
    encode_jpeg(&picture(shade), header, 95).unwrap()
}

fn start(shade: u8) -> Start {
    Start::Frame(Box::new(CameraFrame::Compressed(jpeg(shade, stamp(0)))))
}

fn request(name: &str, seed: u64) -> EnvResetRequest {
    EnvResetRequest {
        episode_id: name.into(),
        seed,
        ..EnvResetRequest::default()
    }
}

fn action(value: f32) -> Action {
    let frame_id = "base".into();
    Action {
        header: Header {
            frame_id,
            ..Header::default()
        },
        values: vec![value, -value, 0.01, 0.0, 0.1, 0.0, 1.0],
    }
}

fn moves(name: &str, values: &[f32]) -> Move {
    Move {
        episode_id: name.into(),
        actions: values.iter().map(|value| action(*value)).collect(),
        ..Move::default()
    }
}

fn step(env: &mut Env, asked: Move) -> Result<Moved, EnvError> {
    env.step(&[asked]).pop().unwrap()
}

/// Data of the observations of an episode that is played alone.
fn alone(shade: u8, seed: u64, chunks: &[&[f32]]) -> Vec<Vec<u8>> {
    let mut env = env(None);
    let (_, first) = env
        .reset(&request("a", seed), &start(shade), stamp(0))
        .unwrap();
    let mut seen = vec![first.jpeg.data];
    for chunk in chunks {
        let moved = step(&mut env, moves("a", chunk)).unwrap();
        seen.extend(
            moved
                .observations
                .into_iter()
                .map(|observation| observation.jpeg.data),
        );
    }
    seen
}

#[test]
fn an_episode_is_seeded_and_ends_after_its_steps() {
    let asked = EnvResetRequest {
        max_steps: 3,
        ..request("a", 7)
    };
    let mut env = env(None);
    let (begun, first) = env.reset(&asked, &start(90), stamp(0)).unwrap();
    assert_eq!(
        (begun.instruction.as_str(), begun.actions_per_step),
        ("wait", 2)
    );
    assert_eq!(begun.step_period, Duration::from_nanos(STEP));
    assert_eq!(first.jpeg.header.stamp, stamp(0));
    assert_eq!(first.picture.dimensions(), (32, 32));

    // Three actions are a step and a half: the last one is held.
    let moved = step(&mut env, moves("a", &[0.01, 0.01, 0.02])).unwrap();
    let stamps: Vec<_> = moved
        .observations
        .iter()
        .map(|o| o.jpeg.header.stamp)
        .collect();
    assert_eq!(stamps, [stamp(STEP), stamp(2 * STEP)]);
    assert_eq!(
        (moved.steps, moved.truncated, moved.capture),
        (2, false, stamp(0))
    );
    let twice = [&[0.01_f32, 0.01][..], &[0.02, 0.02][..]];
    let seen: Vec<_> = moved
        .observations
        .iter()
        .map(|o| o.jpeg.data.clone())
        .collect();
    assert_eq!(
        alone(90, 7, &twice)[1..],
        seen,
        "the same start, actions and seed"
    );
    assert_ne!(alone(90, 8, &twice)[1..], seen, "another seed");
    let others = [&[0.01_f32, 0.01][..], &[-0.02, -0.02][..]];
    assert_ne!(alone(90, 7, &others)[2], seen[1], "other actions");

    // Of two more steps there is one left.
    let moved = step(&mut env, moves("a", &[0.0; 4])).unwrap();
    assert_eq!(
        (moved.observations.len(), moved.steps, moved.truncated),
        (1, 3, true)
    );
    let over = step(&mut env, moves("a", &[0.0])).unwrap_err().to_string();
    assert!(over.contains("has taken its 3 steps"), "{over}");
}

#[test]
fn episodes_side_by_side_are_what_they_are_alone() {
    let mut env = env(None);
    for (name, shade, seed) in [("a", 10, 1), ("b", 120, 2), ("c", 250, 1)] {
        env.reset(&request(name, seed), &start(shade), stamp(0))
            .unwrap();
    }
    // "b" is two steps ahead, so that histories of two lengths meet; batches are of two, and windows slide.
    let mut seen = vec![Vec::new(); 3];
    let mut keep = |index: usize, moved: Moved| {
        seen[index].extend(moved.observations.into_iter().map(|o| o.jpeg.data));
    };
    keep(
        1,
        step(&mut env, moves("b", &[0.02, 0.02, 0.01, 0.01])).unwrap(),
    );
    for round in 0..4 {
        let value = round as f32 * 0.01;
        let asked = [
            moves("a", &[value, value, -value, -value]),
            moves("b", &[0.02]),
            moves("c", &[-value]),
        ];
        for (index, moved) in env.step(&asked).into_iter().enumerate() {
            keep(index, moved.unwrap());
        }
    }
    let chunks = |of: fn(f32) -> Vec<f32>| -> Vec<Vec<f32>> {
        (0..4).map(|round| of(round as f32 * 0.01)).collect()
    };
    fn slices(chunks: &[Vec<f32>]) -> Vec<&[f32]> {
        chunks.iter().map(Vec::as_slice).collect()
    }
    let a = chunks(|value| vec![value, value, -value, -value]);
    assert_eq!(alone(10, 1, &slices(&a))[1..], seen[0]);
    let b = [vec![vec![0.02, 0.02, 0.01, 0.01]], chunks(|_| vec![0.02])].concat();
    assert_eq!(alone(120, 2, &slices(&b))[1..], seen[1]);
    let c = chunks(|value| vec![-value]);
    assert_eq!(alone(250, 1, &slices(&c))[1..], seen[2]);
}

/// The sampler's own rollout, which keeps what it has computed, gives the same latents.
#[test]
fn an_episode_is_the_samplers_rollout() {
    for alignment in [ActionAlignment::WithFrame, ActionAlignment::WithResult] {
        expect_the_samplers_rollout(&world_of(alignment));
    }
}

fn expect_the_samplers_rollout(world: &EnvModel) {
    let still = world.standing_still().unwrap();
    let first = world.see(&picture(60)).unwrap();
    let mut episode = Episode::new(
        vec![first.clone(); 2],
        vec![still.clone()],
        world.window(),
        4,
    );
    let tensor = |values: &[f32], shape: &[usize]| {
        candle_core::Tensor::from_slice(values, shape, &candle_core::Device::Cpu).unwrap()
    };
    let model = world.predictor();
    let (h, w, c) = model.space.shape();
    let context = tensor(&[&first[..], &first[..]].concat(), &[1, 2, h, w, c]);
    let mut sampler = model.transition.config().sampler.clone();
    sampler.steps = world.integration_steps();
    let past = tensor(&still, &[1, 7]);
    let mut rollout = Rollout::new(&model.transition, &sampler, &context, Some(&past), 4).unwrap();
    for k in 0..8 {
        let of = |k: usize| {
            world
                .model_action(&vec![action(0.01 * k as f32); 2])
                .unwrap()
        };
        let (action, next) = (of(k), of(k + 1));
        let own = tensor(&next, &[1, 7]);
        let given = Given {
            own_action: Some(&own),
            ..Given::default()
        };
        let expected = rollout
            .next_given(&tensor(&action, &[1, 7]), given)
            .unwrap();
        let row = Row {
            episode: &episode,
            action: &action,
            next: &next,
        };
        let latent = world.predict(&[row]).unwrap().pop().unwrap();
        assert_eq!(
            expected.flatten_all().unwrap().to_vec1::<f32>().unwrap(),
            latent.to_vec(),
            "step {k}"
        );
        episode.push(action, latent);
    }
}

#[test]
fn an_episode_is_a_bag_in_the_layout_of_the_imports() {
    let folder = tempfile::tempdir().unwrap();
    let mut env = env(Some(folder.path().to_owned()));
    env.reset(&request("", 11), &start(90), stamp(0)).unwrap();
    let id = "episode_000000";
    step(&mut env, moves(id, &[0.01])).unwrap();
    step(&mut env, moves(id, &[0.02, 0.03, 0.04, 0.05])).unwrap();
    let closing = Move {
        close: true,
        outcome: Some(true),
        ..moves(id, &[])
    };
    let closed = step(&mut env, closing).unwrap();
    assert!(closed.truncated && closed.observations.is_empty());
    assert_eq!(env.episodes(), 0);

    let reader = BagReader::open(closed.bag.unwrap()).unwrap();
    let counts: Vec<(&str, u64)> = reader
        .topics()
        .iter()
        .map(|topic| (&*topic.name, topic.message_count))
        .collect();
    assert_eq!(
        counts,
        [
            ("/camera/image_raw/compressed", 4),
            ("/task/instruction", 1),
            ("/task/success", 1),
            ("/wm/action", 6),
            ("/wm/predicted", 3),
        ]
    );
    assert_eq!(reader.note("wm.env.seed"), Some("11"));
    assert_eq!(reader.note("wm.model_hash"), Some("beef"));
    let taken: Vec<(i64, f32)> = reader
        .messages()
        .only_topics(["/wm/action"])
        .map(|message| message.unwrap().decode::<Action>().unwrap())
        .map(|action| (action.header.stamp.to_nanos() - START, action.values[0]))
        .collect();
    let expected = [0.01, 0.01, 0.02, 0.03, 0.04, 0.05];
    let expected: Vec<_> = (0..).map(|index| index * PERIOD).zip(expected).collect();
    assert_eq!(taken, expected, "those that were held are there too");
    let success = reader
        .messages()
        .only_topics(["/task/success"])
        .next()
        .unwrap()
        .unwrap();
    assert!(success.decode::<std_msgs::Bool>().unwrap().data);

    // Another of that name does not overwrite it, and what is not closed is when the env ends.
    env.reset(&request(id, 12), &start(90), stamp(0)).unwrap();
    assert!(env.close().is_empty());
    let second = BagReader::open(folder.path().join("episode_000000_2")).unwrap();
    assert_eq!(second.note("wm.env.seed"), Some("12"));
}

#[test]
fn a_bag_gives_the_history_before_its_frame() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    let text = std_msgs::String {
        data: "lift".into(),
    };
    writer
        .write("/task/instruction", &text, START as u64)
        .unwrap();
    for index in 0..8_i64 {
        let at = START + index * PERIOD;
        let image = jpeg(30 * index as u8, Time::from_nanos(at));
        writer
            .write("/camera/image_raw/compressed", &image, at as u64)
            .unwrap();
        let mut taken = action(0.01 * index as f32);
        taken.header.stamp = Time::from_nanos(at);
        writer.write("/wm/action", &taken, at as u64).unwrap();
    }
    writer.finish().unwrap();
    let world = world();
    let opened = |offset_s| {
        let start = Start::Bag {
            path: bag.clone(),
            offset_s,
        };
        open(&start, &world, Timing::new(PERIOD, 2), 2)
    };
    let opening = opened(1.0).unwrap();
    let see = |index: u8| {
        let frame = CameraFrame::Compressed(jpeg(30 * index, stamp(0)));
        world.see(&frame.decode().unwrap()).unwrap()
    };
    assert_eq!(opening.frames, [see(3), see(5)]);
    let between = [3, 4].map(|index| action(0.01 * index as f32));
    assert_eq!(opening.actions, [world.model_action(&between).unwrap()]);
    assert_eq!(opening.instruction.as_deref(), Some("lift"));
    assert_eq!(opening.frame_id, "camera");

    // Nothing is before the first frame: the robot stood still.
    let opening = opened(0.0).unwrap();
    assert_eq!(opening.frames, [see(0), see(0)]);
    assert_eq!(opening.actions, [world.standing_still().unwrap()]);
    let error = opened(9.0).unwrap_err().to_string();
    assert!(
        error.contains("no camera frame at or after 9.000 s"),
        "{error}"
    );
}

#[test]
fn invalid_moves_are_refused_by_name_and_change_nothing() {
    let mut env = env(None);
    let refused = |env: &mut Env, asked: Move| step(env, asked).unwrap_err().to_string();
    assert!(refused(&mut env, moves("a", &[0.0])).contains("no episode \"a\"; there are: none"));
    env.reset(&request("a", 1), &start(9), stamp(0)).unwrap();
    for name in ["../a", ".a", "a/b", "ä"] {
        let error = env
            .reset(&request(name, 1), &start(9), stamp(0))
            .unwrap_err();
        assert!(matches!(error, EnvError::Name(_)), "{error}");
    }
    assert!(refused(&mut env, moves("a", &[])).starts_with("0 actions"));
    let error = refused(&mut env, moves("a", &[0.0, f32::NAN]));
    assert!(error.starts_with("action 1: "), "{error}");
    let twice = env.step(&[moves("a", &[0.0]), moves("a", &[0.0])]);
    assert!(twice[0].is_ok() && twice[1].is_err());
    env.reset(&request("b", 1), &start(9), stamp(0)).unwrap();
    env.reset(&request("c", 1), &start(9), stamp(0)).unwrap();
    let full = env
        .reset(&request("d", 1), &start(9), stamp(0))
        .unwrap_err();
    assert!(matches!(full, EnvError::Full(3)));
    // One that is open may begin anew.
    env.reset(&request("a", 1), &start(9), stamp(0)).unwrap();
    assert_eq!(step(&mut env, moves("a", &[0.0])).unwrap().steps, 1);
    let two = EnvResetRequest {
        bag: "x".into(),
        image: "y".into(),
        ..EnvResetRequest::default()
    };
    assert!(
        Start::of(&two)
            .unwrap_err()
            .to_string()
            .starts_with("2 of bag, image and topic")
    );
    let missing = Start::Image("/no/such.png".into());
    let error = env
        .reset(&request("a", 1), &missing, stamp(0))
        .unwrap_err()
        .to_string();
    assert!(error.contains("/no/such.png"), "{error}");
}

/// Opening a pipe blocks until a writer opens it, and the env computes one job at a time.
#[test]
fn a_start_that_would_block_is_refused_without_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("pipe");
    let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
    let kind = rustix::fs::FileType::Fifo;
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, kind, mode, 0).unwrap();
    let secret = folder.path().join("secret");
    std::fs::write(&secret, "root:$6$salt").unwrap();
    let mut env = env(None);
    let mut refused = |start: Start| {
        let begun = env.reset(&request("a", 1), &start, stamp(0));
        begun.unwrap_err()
    };
    let errors = [
        refused(Start::Image(pipe)),
        refused(Start::Image(secret.clone())),
        refused(Start::Image("/no/such.png".into())),
        refused(Start::Bag {
            path: secret,
            offset_s: 0.0,
        }),
    ];
    assert!(
        errors[0].to_string().contains("regular file"),
        "{}",
        errors[0]
    );
    for error in errors {
        assert_eq!(
            error.without_file().to_string(),
            EnvError::NoStart.to_string()
        );
    }
}

#[test]
fn a_bag_of_other_actions_is_refused_with_both_sides() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    let space = r#"{"name": "my_arm", "dimensions": [{"name": "elbow", "unit": "rad", "kind": "joint_position"}]}"#;
    writer.note(ActionSpace::NOTE, space);
    let image = jpeg(30, stamp(START));
    writer
        .write("/camera/image_raw/compressed", &image, START as u64)
        .unwrap();
    writer.finish().unwrap();
    let start = Start::Bag {
        path: bag,
        offset_s: 0.0,
    };
    let error = open(&start, &world(), Timing::new(PERIOD, 2), 2).err();
    let error = error.expect("an error").without_file().to_string();
    assert!(
        error.contains("my_arm: elbow") && error.contains("bridge_v2: dx dy dz"),
        "{error}"
    );
}
