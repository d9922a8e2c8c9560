#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod speeds;

use std::time::Instant;

use wm_model::{LatentSpace, WorldModel, sampler::Prepared};
use wm_msgs::{
    builtin_interfaces::Duration,
    std_msgs::Header,
    wm_msgs::{LatentSpace as SpaceMessage, Prediction},
};

use super::*;
use crate::{
    predictor::RunningRollout,
    test_world::{
        PERIOD, START, history, history_of, latent, latent_of, other_space, space, stamp,
        world_model,
    },
};
use wm_ros::PublisherId;
use wm_wire::latent_message::{LatentError, decode_latent, encode_latent};

fn settings() -> PredictorSettings {
    PredictorSettings {
        horizon: 3,
        integration_steps: 1,
        seed: 9,
        dtype: LatentDtype::F32,
        calibration: None,
    }
}

fn predictor() -> PredictorStep {
    PredictorStep::new(settings(), history())
}

fn reception(index: i64) -> Reception {
    Reception {
        stamp: stamp(index),
        clock_step_ns: 0,
        at: Instant::now(),
        publisher: PublisherId::default(),
    }
}

fn action(index: i64) -> Action {
    let header = Header {
        stamp: stamp(index),
        frame_id: "base".into(),
    };
    Action {
        header,
        values: vec![0.01 * (index % 5) as f32, 0.0, -0.01, 0.0, 0.1, 0.0, 1.0],
    }
}

/// Sends frames and actions of a span; returns the outcome of the last frame.
fn feed(step: &mut PredictorStep, span: std::ops::RangeInclusive<i64>) -> Outcome {
    let mut last = None;
    for index in span {
        step.action(&action(index), stamp(index)).unwrap();
        last = Some(step.latent(&latent(index), reception(index)).unwrap());
    }
    last.unwrap()
}

/// The action of `index` and all to come, until that of `end`, as a policy announces them.
fn chunk(index: i64, end: i64) -> ActionChunk {
    ActionChunk {
        header: action(index).header,
        period: Duration::from_nanos(PERIOD),
        actions: (index..end).map(action).collect(),
        ..ActionChunk::default()
    }
}

fn run(model: &WorldModel, outcome: Outcome) -> Vec<PredictedStep> {
    let request = outcome.rollout.unwrap().unwrap();
    let rollout = RunningRollout::new(model, request).unwrap();
    rollout.collect::<Result<_, _>>().unwrap()
}

#[test]
fn a_rollout_says_what_it_was_computed_from() {
    let (model, mut step) = (world_model(), predictor());
    let predictions: Vec<Prediction> = run(&model, feed(&mut step, 0..=2))
        .into_iter()
        .map(|predicted| predicted.prediction)
        .collect();
    assert_eq!(predictions.len(), 3);
    for (index, prediction) in predictions.iter().enumerate() {
        let k = index as i64 + 1;
        assert_eq!(prediction.header.stamp, stamp(2 + 2 * k));
        assert_eq!(prediction.header.frame_id, "camera");
        assert_eq!(prediction.latent.header, prediction.header);
        assert_eq!(prediction.observed_stamp, stamp(2));
        assert_eq!((prediction.step, prediction.horizon), (k as u32, 3));
        assert_eq!(prediction.step_period, Duration::from_nanos(2 * PERIOD));
        assert_eq!((prediction.seed, prediction.integration_steps), (9, 1));
        assert_eq!(
            (prediction.model.as_str(), prediction.model_hash.as_str()),
            ("test", "beef")
        );
        assert_eq!(prediction.received_stamp, stamp(2));
        assert_eq!(prediction.epoch, step.epoch());
        assert_eq!(prediction.actions.len(), 2 * k as usize);
        for (slot, assumed) in prediction.actions.iter().enumerate() {
            assert_eq!(assumed.header.stamp, stamp(2 + slot as i64));
            assert_eq!(assumed.header.frame_id, "base");
            assert_eq!(assumed.values, action(2).values, "the last motion goes on");
        }
    }
}

#[test]
fn predictions_from_a_stopped_camera_are_doubted() {
    let mut step = predictor();
    feed(&mut step, 0..=3);
    assert_eq!(step.doubt(), None);
    let frozen = Latent {
        frozen: true,
        ..latent(4)
    };
    step.latent(&frozen, reception(4)).unwrap();
    assert_eq!(step.doubt(), Some(Doubt::Frozen));
    feed(&mut step, 5..=5);
    assert_eq!(step.doubt(), None);
}

#[test]
fn computing_ahead_of_the_observation_changes_no_prediction() {
    let (model, mut step) = (world_model(), predictor());
    feed(&mut step, 0..=1);
    assert!(
        step.ahead(stamp(4).to_nanos()).is_none(),
        "its earlier frame is still to come"
    );
    let ahead = step.ahead(stamp(2).to_nanos()).unwrap();
    let prepared = ahead.prepare(&model).unwrap();
    let request = feed(&mut step, 2..=2).rollout.unwrap().unwrap();
    let values = |prepared: Option<&Prepared>| -> Vec<_> {
        let rollout = RunningRollout::new(&model, request.clone()).unwrap();
        let steps = rollout.taking_over(prepared);
        steps.map(|step| step.unwrap().values).collect()
    };
    assert_eq!(values(Some(&prepared)), values(None));

    let mut rollout = (request.moment)
        .rollout(&model.transition, &model.transition.config().sampler, 9)
        .unwrap();
    assert_eq!(rollout.take_over(&prepared), 1);
}

#[test]
fn predictions_depend_on_messages_and_seed_alone() {
    let model = world_model();
    let predict = |seed: Option<u64>| {
        let mut step = predictor();
        if seed.is_some() {
            step.reset(seed, Time::default());
        }
        run(&model, feed(&mut step, 0..=4))
    };
    let bytes = |steps: &[PredictedStep]| -> Vec<Vec<u8>> {
        steps
            .iter()
            .map(|step| step.prediction.latent.data.clone())
            .collect()
    };
    assert_eq!(bytes(&predict(None)), bytes(&predict(Some(9))));
    assert_ne!(bytes(&predict(None)), bytes(&predict(Some(10))));
}

#[test]
fn the_chunk_is_assumed_and_changes_the_prediction() {
    let model = world_model();
    let held = run(&model, feed(&mut predictor(), 0..=2));
    let mut step = predictor();
    step.chunk(&chunk(2, 9), stamp(2)).unwrap();
    let informed = run(&model, feed(&mut step, 0..=2));
    let assumed: Vec<_> = informed[2]
        .prediction
        .actions
        .iter()
        .map(|action| action.values.clone())
        .collect();
    assert_eq!(
        assumed,
        (2..8).map(|index| action(index).values).collect::<Vec<_>>()
    );
    assert_ne!(held[0].values, informed[0].values);
}

#[test]
fn predictions_are_scored_when_their_moment_comes() {
    let (model, mut step) = (world_model(), predictor());
    let predicted = run(&model, feed(&mut step, 0..=2));
    for one in &predicted {
        assert_eq!(step.predicted(one), None);
    }
    assert!(feed(&mut step, 3..=3).errors.is_empty());
    let errors = feed(&mut step, 4..=4).errors;
    assert_eq!(errors.len(), 1);
    let values = |index: i64| decode_latent(&latent(index), &space()).unwrap();
    let mse = wm_metrics::images::mean_squared_error(&predicted[0].values, &values(4)).unwrap();
    let persistence = wm_metrics::images::mean_squared_error(&values(2), &values(4)).unwrap();
    let error = &errors[0];
    assert_eq!(
        (error.header.stamp, error.observed_stamp, error.step),
        (stamp(4), stamp(2), 1)
    );
    assert!(
        (f64::from(error.mse) - mse).abs() < 1e-6
            && (f64::from(error.persistence_mse) - persistence).abs() < 1e-6
    );
    assert!((f64::from(error.ratio) - mse / persistence).abs() < 1e-4);

    // The frame of k = 2 never comes; that of k = 3 is scored all the same, and k = 2 is forgotten.
    let errors = step.latent(&latent(8), reception(8)).unwrap().errors;
    assert_eq!(
        errors.iter().map(|error| error.step).collect::<Vec<_>>(),
        [3]
    );
}

/// A policy answers an image after the encoder does: the rollout of its frame is made again.
#[test]
fn late_chunk_makes_the_rollout_due_again() {
    let (model, mut step) = (world_model(), predictor());
    let held = run(&model, feed(&mut step, 0..=2));
    for one in &held {
        step.predicted(one);
    }
    let outcome = step.chunk(&chunk(2, 10), stamp(2)).unwrap();
    assert!(outcome.arrival.is_due);
    let informed = run(&model, outcome);
    assert_eq!(informed[0].prediction.observed_stamp, stamp(2));
    assert_eq!(informed[0].prediction.actions[1].values, action(3).values);
    assert_ne!(held[0].values, informed[0].values);
    for one in &informed {
        assert_eq!(step.predicted(one), None);
    }
    // Only the second prediction of each moment is scored.
    feed(&mut step, 3..=3);
    let errors = feed(&mut step, 4..=4).errors;
    assert_eq!(errors.len(), 1);
    let seen = decode_latent(&latent(4), &space()).unwrap();
    let mse = wm_metrics::images::mean_squared_error(&informed[0].values, &seen).unwrap();
    assert!((f64::from(errors[0].mse) - mse).abs() < 1e-6);

    let ahead = step.chunk(&chunk(6, 10), stamp(4)).unwrap();
    assert!(
        ahead.rollout.is_none(),
        "it answers a frame that is on its way"
    );
}

#[test]
fn a_prediction_that_is_late_is_scored_at_once() {
    let (model, mut step) = (world_model(), predictor());
    let outcome = feed(&mut step, 0..=2);
    feed(&mut step, 3..=4);
    let predicted = run(&model, outcome);
    assert_eq!(
        step.predicted(&predicted[0]).map(|error| error.step),
        Some(1)
    );
    assert_eq!(step.predicted(&predicted[1]), None);
}

#[test]
fn a_loop_flushes_history_and_open_predictions() {
    let (model, mut step) = (world_model(), predictor());
    let predicted = run(&model, feed(&mut step, 0..=40));
    for one in &predicted {
        step.predicted(one);
    }
    // One frame may be a broken stamp; the second says that time has jumped.
    let outcome = feed(&mut step, 0..=0);
    assert!(outcome.arrival.held_back && outcome.rollout.is_none());
    let outcome = feed(&mut step, 1..=1);
    assert!(outcome.arrival.flushed && outcome.errors.is_empty());
    assert_eq!(
        outcome.rollout.unwrap().unwrap_err(),
        Wait::Context { have: 1, need: 2 }
    );
    assert_eq!(step.predicted(&predicted[1]), None, "of the time before");
    // Up to the moments of the old predictions: only new ones may be scored, and there are none.
    for index in 2..=46 {
        let again = feed(&mut step, index..=index);
        assert!(again.errors.is_empty() && again.rollout.unwrap().is_ok());
    }
}

#[test]
fn one_odd_stamp_neither_flushes_nor_scores_nor_predicts() {
    let (model, mut step) = (world_model(), predictor());
    let predicted = run(&model, feed(&mut step, 0..=2));
    for one in &predicted {
        step.predicted(one);
    }
    let mut odd = latent(4);
    odd.header.stamp = stamp(-18_000);
    let outcome = step.latent(&odd, reception(3)).unwrap();
    assert!(outcome.arrival.held_back && outcome.errors.is_empty() && outcome.rollout.is_none());
    let next = feed(&mut step, 3..=4);
    assert_eq!((next.errors.len(), next.arrival.flushed), (1, false));
    assert!(next.rollout.unwrap().is_ok());
}

#[test]
fn bad_input_is_named_and_leaves_the_state_as_it_was() {
    let mut step = predictor();
    let before = feed(&mut step, 0..=2).rollout.unwrap().unwrap();
    let refused =
        |step: &mut PredictorStep, latent: &Latent| step.latent(latent, reception(9)).unwrap_err();

    let foreign = Latent {
        space: SpaceMessage {
            name: "other".into(),
            hash: "11".into(),
        },
        ..latent(3)
    };
    let error = refused(&mut step, &foreign);
    assert!(
        error
            .to_string()
            .contains("\"other\" (11); expected \"test\" (00ff)"),
        "{error}"
    );
    assert_eq!(error.reason(), "wrong_space");

    let mut nan = latent(3);
    nan.data.splice(0..4, f32::NAN.to_le_bytes());
    let error = refused(&mut step, &nan);
    assert!(
        matches!(
            error,
            HistoryError::Latent(LatentError::NotFinite { index: 0 })
        ),
        "{error}"
    );

    assert_eq!(refused(&mut step, &latent(2)).reason(), "duplicate");
    assert_eq!(refused(&mut step, &latent(1)).reason(), "out_of_order");
    let mut infinite = action(3);
    infinite.values[0] = f32::INFINITY;
    let error = step.action(&infinite, stamp(3)).unwrap_err();
    assert!(matches!(error, HistoryError::Action { .. }), "{error}");

    let after = step.request().unwrap();
    let (before_moment, moment) = (before.moment, after.moment);
    assert_eq!(moment.epoch, before_moment.epoch);
    assert_eq!(moment.observed, before_moment.observed);
    assert_eq!(moment.earlier, before_moment.earlier);
    assert_eq!(moment.past, before_moment.past);
    assert_eq!(after.future, before.future);
}

#[test]
fn without_actions_it_waits_and_says_so() {
    let mut step = predictor();
    for index in 0..4 {
        step.latent(&latent(index), reception(index)).unwrap();
    }
    let wait = step
        .latent(&latent(4), reception(4))
        .unwrap()
        .rollout
        .unwrap()
        .unwrap_err();
    assert!(matches!(wait, Wait::NoAction { .. }));
    assert!(wait.to_string().contains("no action has arrived"), "{wait}");
}

#[test]
fn a_prediction_fits_a_message_that_ros_can_receive() {
    let large = LatentSpace {
        height: 16,
        width: 16,
        channels: 96,
        ..space()
    };
    let prediction = Prediction {
        latent: encode_latent(
            &vec![0.0; 24_576],
            &large,
            LatentDtype::F16,
            Header::default(),
        )
        .unwrap(),
        actions: (0..32).map(action).collect(),
        ..Prediction::default()
    };
    // Beyond about 98 KB, Fast DDS's default receive buffer loses messages.
    assert!(wm_msgs::cdr::to_bytes(&prediction).unwrap().len() < 98_000);
}

/// The factors come from frames up to the observation, also when more have arrived meanwhile.
#[test]
fn motion_of_a_prediction_is_scaled_by_the_factor_of_the_last_ones() {
    let model = world_model();
    let calibration = CalibrationSettings {
        window: 50,
        prior: 0.0,
        bounds: (0.0, 1.0),
    };
    let mut step = PredictorStep::new(
        PredictorSettings {
            calibration: Some(calibration),
            ..settings()
        },
        history(),
    );
    for index in 0..12 {
        let outcome = feed(&mut step, index..=index);
        if let Some(Ok(request)) = outcome.rollout {
            let rollout = RunningRollout::new(&model, request).unwrap();
            for one in rollout {
                step.predicted(&one.unwrap());
            }
        }
    }
    let outcome = feed(&mut step, 12..=12);
    let request = outcome.rollout.unwrap().unwrap();
    let observed_ns = request.moment.observed.stamp_ns;
    let fits = step.fits(3, observed_ns);
    assert_eq!(fits.len(), 3);
    assert!(fits.iter().any(|fit| fit.factor < 1.0), "{fits:?}");
    feed(&mut step, 13..=14);
    assert_eq!(step.fits(3, observed_ns), fits);

    let of = |fits| {
        RunningRollout::new(&model, request.clone())
            .unwrap()
            .calibrated(fits)
    };
    let raw: Vec<_> = of(Vec::new()).map(Result::unwrap).collect();
    let calibrated: Vec<_> = of(fits.clone()).map(Result::unwrap).collect();
    for ((raw, calibrated), fit) in raw.iter().zip(&calibrated).zip(&fits) {
        assert_eq!(
            raw.values, calibrated.values,
            "the rollout goes on from the unscaled latents"
        );
        let published = decode_latent(&calibrated.prediction.latent, &space()).unwrap();
        let observed = calibrated.observed.values.iter().zip(&*raw.values);
        for (published, (observed, raw)) in published.iter().zip(observed) {
            let expected = f64::from(*observed) + fit.factor * f64::from(raw - observed);
            assert!((f64::from(*published) - expected).abs() < 1e-5);
        }
    }
    step.reset(None, stamp(14));
    assert!(
        step.fits(3, observed_ns)
            .iter()
            .all(|fit| fit.factor == 1.0)
    );
}

#[test]
fn another_model_predicts_from_the_same_frames_at_once() {
    let mut before = predictor();
    feed(&mut before, 0..=4);
    let mut after = predictor();
    let request = after.continue_from(&before, stamp(5)).unwrap();
    assert_eq!(request.moment.observed.stamp_ns, stamp(4).to_nanos());
    assert!(after.epoch() > before.epoch());
    assert!(after.ratios().is_empty() && after.fits(1, i64::MAX).is_empty());
}

#[test]
fn model_of_another_space_predicts_when_the_frames_are_sent_again() {
    let mut before = predictor();
    feed(&mut before, 0..=4);
    let mut after = PredictorStep::new(settings(), history_of(other_space()));
    assert!(after.continue_from(&before, stamp(5)).is_none());
    let mut see = |index| {
        let latent = latent_of(index, &other_space());
        after.latent(&latent, reception(index)).unwrap().rollout
    };
    for index in 2..4 {
        assert!(see(index).unwrap().is_err(), "the context is not whole");
    }
    let request = see(4).unwrap().unwrap();
    assert_eq!(request.moment.observed.stamp_ns, stamp(4).to_nanos());
    let expected = before.request().unwrap();
    assert_eq!(request.moment.past, expected.moment.past);
    assert_eq!(request.future, expected.future);
}
