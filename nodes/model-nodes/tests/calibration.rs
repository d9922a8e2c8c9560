//! The calibration on whole streams, through the bundled model: compared with the persistence baseline and with raw
//! predictions. `WM_TEST_BAGS` names folders of further recordings (`wm bag import` writes them), separated by colons. The
//! bags of a folder are one stream. Its actions count where they have seven values.

use crate::running::computing;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};
use wm_bag::BagReader;
use wm_camera::{camera_frame::CameraFrame, goal::camera_topic};
use wm_model::WorldModel;
use wm_model_nodes::{
    encoder::EncoderStep,
    history::{HistoryBuilder, Reception},
    predictor::{CalibrationSettings, PredictorSettings, PredictorStep, RunningRollout},
};
use wm_motion::motion::ChunkMerging;
use wm_msgs::{
    builtin_interfaces::Time,
    std_msgs::Header,
    wm_msgs::{Action, Latent, PredictionError},
};
use wm_ros::PublisherId;
use wm_wire::latent_message::{LatentDtype, encode_latent};
use wm_zoo::ModelFolder;

const HORIZON: usize = 8;
const PERIOD_NS: i64 = 200_000_000;
/// Scored predictions before the calibration is judged.
const LEARNING: usize = 20;
/// The predictor's default.
const CALIBRATION: CalibrationSettings = CalibrationSettings {
    window: 50,
    prior: 1.0,
    bounds: (0.0, 1.0),
};

/// A camera's latents and the robot's actions, as messages.
#[derive(Default)]
struct Stream {
    name: String,
    /// From one frame to the next.
    period_ns: i64,
    latents: Vec<Latent>,
    actions: Vec<Action>,
}

/// Squared errors, summed.
#[derive(Clone, Copy, Default)]
struct Errors {
    scored: usize,
    mse: f64,
    persistence: f64,
}

fn model() -> (ModelFolder, WorldModel) {
    let folder = ModelFolder::open("tiny").unwrap();
    let model = folder.world_model().unwrap();
    (folder, model)
}

/// The frames of bags at the model's rate or the camera's, whichever is slower, and their actions. There are two seconds
/// between one bag and the next.
fn of_bags(name: &Path, bags: &[PathBuf]) -> Stream {
    let folder = ModelFolder::open("tiny").unwrap();
    let encoder = EncoderStep::of_model(&folder, LatentDtype::F32).unwrap();
    let mut stream = Stream {
        name: name.display().to_string(),
        ..Stream::default()
    };
    let mut end_ns = 0;
    for bag in bags {
        let reader = BagReader::open(bag).unwrap();
        let camera = camera_topic(&reader, "").unwrap();
        let begin_ns = reader.messages().next().unwrap().unwrap().log_time_ns as i64;
        let moved =
            |stamp: Time| Time::from_nanos(stamp.to_nanos() - begin_ns + end_ns + 2_000_000_000);
        let mut newest_ns = 0;
        for message in reader.messages().only_topics([&*camera, "/wm/action"]) {
            let message = message.unwrap();
            if &*message.topic == "/wm/action" {
                let mut action: Action = message.decode().unwrap();
                action.header.stamp = moved(action.header.stamp);
                stream.actions.push(action);
                continue;
            }
            let frame = CameraFrame::of_bag(&message).unwrap();
            let stamp = moved(frame.header().stamp);
            if stamp.to_nanos() - newest_ns > PERIOD_NS * 3 / 4 {
                let mut latent = encoder.encode(&frame).unwrap();
                latent.header.stamp = stamp;
                stream.latents.push(latent);
                newest_ns = stamp.to_nanos();
            }
        }
        end_ns = newest_ns;
    }
    let mut gaps: Vec<_> = stream
        .latents
        .windows(2)
        .map(|two| two[1].header.stamp.to_nanos() - two[0].header.stamp.to_nanos())
        .collect();
    gaps.sort_unstable();
    stream.period_ns = gaps[gaps.len() / 2].max(PERIOD_NS);
    if stream.actions.iter().any(|action| action.values.len() != 7) {
        stream.actions = still(&stream.latents);
    }
    stream
}

/// Actions without motion at the time of each latent.
fn still(latents: &[Latent]) -> Vec<Action> {
    let of = |latent: &Latent| Action {
        header: latent.header.clone(),
        values: vec![0.0; 7],
    };
    latents.iter().map(of).collect()
}

/// Latents that have nothing to do with each other.
fn noise() -> Stream {
    let (folder, _) = model();
    let space = folder.space().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let latents: Vec<_> = (0..120)
        .map(|index| {
            let values: Vec<f32> = (0..space.elements())
                .map(|_| random.random_range(-2.0..2.0))
                .collect();
            let header = Header {
                stamp: Time::from_nanos((index + 10) * PERIOD_NS),
                frame_id: "camera".into(),
            };
            encode_latent(&values, &space, LatentDtype::F32, header).unwrap()
        })
        .collect();
    Stream {
        name: "noise".into(),
        period_ns: PERIOD_NS,
        actions: still(&latents),
        latents,
    }
}

/// The errors of each k after the first [`LEARNING`] ones.
fn errors(
    model: &WorldModel,
    stream: &Stream,
    calibration: Option<CalibrationSettings>,
) -> BTreeMap<u32, Errors> {
    let settings = PredictorSettings {
        horizon: HORIZON,
        integration_steps: model.transition.config().sampler.steps,
        seed: 0,
        dtype: LatentDtype::F32,
        calibration,
    };
    let period_s = stream.period_ns as f64 / 1e9;
    let history = HistoryBuilder::new(model, period_s, 2, ChunkMerging::Latest);
    let history = history.begin(Time::default());
    let mut step = PredictorStep::new(settings, history);
    let mut sums: BTreeMap<u32, Errors> = BTreeMap::new();
    let mut take = |errors: Vec<PredictionError>| {
        for error in errors {
            let sum = sums.entry(error.step).or_default();
            sum.scored += 1;
            if sum.scored > LEARNING {
                sum.mse += f64::from(error.mse);
                sum.persistence += f64::from(error.persistence_mse);
            }
        }
    };
    let mut actions = stream.actions.iter().peekable();
    for latent in &stream.latents {
        let stamp = latent.header.stamp;
        while let Some(action) = actions.next_if(|action| action.header.stamp <= stamp) {
            // As in the node, actions that the model does not take are dropped.
            step.action(action, stamp).ok();
        }
        let reception = Reception {
            stamp,
            clock_step_ns: 0,
            at: Instant::now(),
            publisher: PublisherId::default(),
        };
        let outcome = step.latent(latent, reception).unwrap();
        take(outcome.errors);
        let Some(Ok(request)) = outcome.rollout else {
            continue;
        };
        let fits = step.fits(HORIZON, request.moment.observed.stamp_ns);
        let rollout = RunningRollout::new(model, request).unwrap();
        for predicted in rollout.calibrated(fits) {
            take(step.predicted(&predicted.unwrap()).into_iter().collect());
        }
    }
    sums
}

fn bundled() -> Stream {
    let bag = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bags/tabletop");
    of_bags(Path::new("tabletop"), &[bag])
}

/// Judges a stream, and prints a row for each k. Returns the ratios to the raw predictions' errors.
fn judge(model: &WorldModel, stream: &Stream) -> Vec<f64> {
    let raw = errors(model, stream, None);
    let calibrated = errors(model, stream, Some(CALIBRATION));
    assert!(
        !calibrated.is_empty(),
        "{}: nothing is predicted",
        stream.name
    );
    let mut ratios = Vec::new();
    for ((k, raw), calibrated) in raw.iter().zip(calibrated.values()) {
        let judged = raw.scored.saturating_sub(LEARNING);
        if judged < LEARNING {
            continue;
        }
        let persistence = calibrated.persistence;
        let (was, is) = (raw.mse / persistence, calibrated.mse / persistence);
        println!(
            "{}: k = {k}, n = {judged}: raw {was:.3}, calibrated {is:.3}",
            stream.name
        );
        assert!(is <= 1.02, "{}: k = {k}: {is}", stream.name);
        ratios.push(calibrated.mse / raw.mse);
    }
    ratios
}

#[test]
fn simulator_is_predicted_no_worse_than_without_calibration() {
    let _computing = computing();
    let (_, model) = model();
    let ratios = judge(&model, &bundled());
    assert!(!ratios.is_empty());
    for ratio in ratios {
        assert!(ratio <= 1.01, "{ratio}");
    }
}

#[test]
fn noise_and_foreign_cameras_are_predicted_as_well_as_by_the_last_frame() {
    let _computing = computing();
    let (_, model) = model();
    assert!(!judge(&model, &noise()).is_empty());
    let folders = std::env::var_os("WM_TEST_BAGS").unwrap_or_default();
    let folders: Vec<_> = std::env::split_paths(&folders).collect();
    for folder in folders.iter().filter(|folder| folder.is_dir()) {
        let mut bags: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.is_dir())
            .collect();
        bags.sort();
        assert!(!judge(&model, &of_bags(folder, &bags)).is_empty());
    }
}

/// The bundled robot's pictures, but the actions of nobody.
#[test]
fn wrong_actions_cannot_make_predictions_worse_than_the_last_frame() {
    let _computing = computing();
    let (_, model) = model();
    let mut stream = bundled();
    stream.name += " with reversed actions";
    for action in &mut stream.actions {
        action
            .values
            .iter_mut()
            .take(6)
            .for_each(|value| *value = -*value);
    }
    judge(&model, &stream);
}
