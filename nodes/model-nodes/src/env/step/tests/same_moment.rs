//! Every node makes the same model input of the same messages: what the predictor predicts, the evaluator assesses, the
//! env plays and the library computes are one rollout.

use std::time::Instant;

use candle_core::{Device, Tensor};
use wm_motion::motion::{Chunk, ChunkMerging, Motion, MotionSettings};
use wm_msgs::wm_msgs::{ActionCandidates, ActionChunk};
use wm_ros::PublisherId;

use super::*;
use crate::{
    evaluator::{EvaluatorModel, EvaluatorSettings, EvaluatorStep},
    history::{History, HistorySettings, Reception},
    predictor::{PredictorSettings, PredictorStep, RunningRollout},
};

const HORIZON: usize = 3;
const CONTEXT: usize = 3;
const NEWEST: i64 = 8;
const SEED: u64 = 21;
/// The robot's driver tells its actions at 30 Hz \[ns\].
const TICK: i64 = 33_333_333;
/// The policy plans at 10 Hz \[ns\].
const CHUNK_PERIOD: i64 = 100_000_000;

/// The same messages for all: frames at 5 Hz, actions at 30 Hz, a chunk that answers the newest frame.
struct Messages {
    frames: Vec<CompressedImage>,
    actions: Vec<Action>,
    chunk: ActionChunk,
}

/// No two are alike, and the gripper opens and closes.
fn moving(index: i64, pace: f32) -> Vec<f32> {
    let phase = index as f32;
    let wave = |speed: f32| pace * (phase * speed).sin();
    vec![
        0.02 * wave(0.7),
        0.01 * wave(0.3),
        -0.015 * wave(1.1),
        0.2 * wave(0.5),
        0.1 * wave(0.9),
        -0.15 * wave(1.3),
        f32::from(index % 7 < 4),
    ]
}

fn action_at(ns: i64, values: Vec<f32>) -> Action {
    Action {
        header: Header {
            stamp: stamp(ns),
            frame_id: "base".into(),
        },
        values,
    }
}

/// With a chunk of so many actions.
fn messages(chunk: i64) -> Messages {
    let newest_ns = NEWEST * PERIOD;
    let frames = (0..=NEWEST).map(|index| jpeg(25 * index as u8, stamp(index * PERIOD)));
    let ticks = (0..).take_while(|tick| tick * TICK <= newest_ns);
    let actions = ticks.map(|tick| action_at(tick * TICK, moving(tick, 0.2)));
    let announced =
        (0..chunk).map(|index| action_at(newest_ns + index * CHUNK_PERIOD, moving(5 - index, 0.5)));
    Messages {
        frames: frames.collect(),
        actions: actions.collect(),
        chunk: ActionChunk {
            header: action_at(newest_ns, Vec::new()).header,
            period: Duration::from_nanos(CHUNK_PERIOD),
            actions: announced.collect(),
            ..ActionChunk::default()
        },
    }
}

impl Messages {
    fn write(&self, bag: &std::path::Path) {
        let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
        let mut actions = self.actions.iter().peekable();
        for frame in &self.frames {
            let frame_ns = frame.header.stamp.to_nanos();
            while let Some(action) =
                actions.next_if(|action| action.header.stamp.to_nanos() <= frame_ns)
            {
                let action_ns = action.header.stamp.to_nanos() as u64;
                writer.write("/wm/action", action, action_ns).unwrap();
            }
            writer
                .write("/camera/image_raw/compressed", frame, frame_ns as u64)
                .unwrap();
        }
        writer.finish().unwrap();
    }

    /// The latents of the frames.
    fn latents(&self, world: &EnvModel) -> Vec<Arc<[f32]>> {
        let see = |frame: &CompressedImage| {
            let frame = CameraFrame::Compressed(frame.clone());
            world.see(&frame.decode().unwrap()).unwrap()
        };
        self.frames.iter().map(see).collect()
    }

    fn latent_messages(&self, world: &EnvModel) -> Vec<wm_msgs::wm_msgs::Latent> {
        let frames = self.frames.iter().zip(self.latents(world));
        let space = &world.predictor().space;
        frames
            .map(|(frame, values)| {
                encode_latent(&values, space, LatentDtype::F32, frame.header.clone()).unwrap()
            })
            .collect()
    }
}

fn history(world: &EnvModel) -> History {
    let settings = HistorySettings {
        timing: Timing::new(PERIOD, 2),
        context_frames: CONTEXT,
        merging: ChunkMerging::Latest,
    };
    let model = world.predictor();
    History::new(
        settings,
        model.space.clone(),
        model.encoding.clone(),
        Time::default(),
    )
}

fn reception() -> Reception {
    Reception {
        stamp: Time::default(),
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId::default(),
    }
}

type Latents = Vec<Vec<f32>>;

/// The predictor's, and the camera-rate actions of the coming model steps that it assumed, of one more than it predicts.
fn predicted(world: &EnvModel, messages: &Messages) -> (Latents, Vec<Action>) {
    let settings = PredictorSettings {
        horizon: HORIZON,
        integration_steps: world.integration_steps(),
        seed: SEED,
        dtype: LatentDtype::F32,
        calibration: None,
    };
    let mut step = PredictorStep::new(settings, history(world));
    for action in &messages.actions {
        step.action(action, Time::default()).unwrap();
    }
    for latent in messages.latent_messages(world) {
        step.latent(&latent, reception()).unwrap();
    }
    let outcome = step.chunk(&messages.chunk, Time::default()).unwrap();
    let request = outcome.rollout.unwrap().unwrap();
    let future = request.future.clone();
    let assumed = (0..)
        .zip(&future)
        .flat_map(|(k, step)| request.moment.messages(k, step));
    let assumed = assumed.collect();
    let rollout = RunningRollout::new(world.predictor(), request).unwrap();
    let latents = rollout.map(|step| step.unwrap().values.to_vec()).collect();
    (latents, assumed)
}

/// The evaluator's, of the chunk as the only candidate.
fn assessed(world: &EnvModel, messages: &Messages) -> Latents {
    let settings = EvaluatorSettings {
        max_age: std::time::Duration::from_secs(60),
        horizon: HORIZON,
        max_candidates: 1,
        seed: SEED,
    };
    let mut step = EvaluatorStep::new(settings, history(world));
    for action in &messages.actions {
        step.action(action, Time::default()).unwrap();
    }
    for latent in messages.latent_messages(world) {
        step.latent(&latent, reception()).unwrap();
    }
    let asked = ActionCandidates {
        chunks: vec![messages.chunk.clone()],
        ..ActionCandidates::default()
    };
    let request = step
        .candidates(&asked, Instant::now(), Time::default())
        .unwrap();
    let model = EvaluatorModel::new(world.predictor().clone(), world.integration_steps());
    let latents = model.evaluate(&request).unwrap().latents;
    latents.concat()
}

/// The env's, from a bag of the same frames and actions, with the actions that the predictor assumed.
fn played(world: EnvModel, messages: &Messages, assumed: &[Action]) -> Latents {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    messages.write(&bag);
    let settings = EnvSettings {
        context_frames: CONTEXT,
        ..settings(None)
    };
    let mut env = Env::new(world, settings, Timing::new(PERIOD, 2));
    let start = Start::Bag {
        path: bag,
        offset_s: NEWEST as f64 * PERIOD as f64 / 1e9,
    };
    env.reset(&request("a", SEED), &start, stamp(0)).unwrap();
    let asked = Move {
        episode_id: "a".into(),
        actions: assumed.to_vec(),
        ..Move::default()
    };
    // The window holds exactly the steps that were taken.
    assert_eq!(step(&mut env, asked).unwrap().steps, WINDOW as u32 - 1);
    let frames = env.sessions["a"].episode.frames();
    frames.take(HORIZON).map(|frame| frame.to_vec()).collect()
}

/// The library's.
fn computed(world: &EnvModel, messages: &Messages) -> Latents {
    let model = world.predictor();
    let (encoding, space) = (&model.encoding, model.encoding.space());
    let mut motion = Motion::new(MotionSettings::of_period(PERIOD));
    for action in &messages.actions {
        motion.take(
            action.header.stamp.to_nanos(),
            action.values.as_slice().into(),
        );
    }
    let announced = messages.chunk.actions.iter();
    let announced = announced
        .map(|action| action.values.as_slice().into())
        .collect();
    let chunk_ns = messages.chunk.header.stamp.to_nanos();
    motion.announce(
        Chunk::new(space, chunk_ns, CHUNK_PERIOD, announced).unwrap(),
        space,
    );
    let newest_ns = START + NEWEST * PERIOD;
    let of = |k: i64| {
        let from_ns = newest_ns + k * STEP;
        let step = motion.step(encoding, from_ns, from_ns + STEP).unwrap();
        Tensor::from_vec(step.model.values, (1, 7), &Device::Cpu).unwrap()
    };
    let past = Tensor::cat(&[of(-2), of(-1)], 0).unwrap();
    let latents = messages.latents(world);
    let context: Vec<f32> = [4, 6, 8]
        .iter()
        .flat_map(|index: &usize| latents[*index].to_vec())
        .collect();
    let (h, w, c) = model.space.shape();
    let context = Tensor::from_vec(context, (1, CONTEXT, h, w, c), &Device::Cpu).unwrap();
    let mut sampler = model.transition.config().sampler.clone();
    sampler.steps = world.integration_steps();
    let rollout = Rollout::new(&model.transition, &sampler, &context, Some(&past), SEED);
    let mut rollout = rollout.unwrap();
    (0..HORIZON as i64)
        .map(|k| {
            let next = of(k + 1);
            let given = Given {
                own_action: Some(&next),
                ..Given::default()
            };
            let latent = rollout.next_given(&of(k), given).unwrap();
            latent.flatten_all().unwrap().to_vec1().unwrap()
        })
        .collect()
}

fn expect_equal(found: &Latents, expected: &Latents, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (k, (found, expected)) in (1..).zip(found.iter().zip(expected)) {
        let pairs = found.iter().zip(expected);
        let apart = pairs.map(|(a, b)| (a - b).abs()).fold(0.0_f32, f32::max);
        assert!(apart < 1e-5, "{what}, step {k}: {apart} apart");
    }
}

#[test]
fn all_nodes_and_the_library_compute_one_rollout() {
    for alignment in [ActionAlignment::WithFrame, ActionAlignment::WithResult] {
        // One that speaks of more than the horizon, and one that ends with it: then its last motion goes on.
        for count in [20, 12] {
            let messages = messages(count);
            let world = world_of(alignment);
            let what = |who: &str| format!("{who}, {alignment:?}, {count} actions");
            let expected = computed(&world, &messages);
            assert!(expected[0] != expected[1]);
            let (latents, assumed) = predicted(&world, &messages);
            expect_equal(&latents, &expected, &what("the predictor"));
            let latents = assessed(&world, &messages);
            expect_equal(&latents, &expected, &what("the evaluator"));
            let latents = played(world, &messages, &assumed);
            expect_equal(&latents, &expected, &what("the env"));
        }
    }
}
