//! Vetoes by the model's predictions.

use wm_msgs::wm_msgs::CandidateAssessment;

use super::*;
use crate::executor::Veto;

fn assessment(stamp_ms: i64, success: f32) -> Assessment {
    Assessment {
        candidates_stamp: Time::from_nanos(START + stamp_ms * MS),
        candidates: vec![CandidateAssessment {
            success_probability: success,
            ..CandidateAssessment::default()
        }],
        ..Assessment::default()
    }
}

fn vetoing(is_required: bool) -> Settings {
    let mut settings = settings();
    settings.veto.min_success = 0.5;
    settings.veto.is_required = is_required;
    settings
}

#[test]
fn a_chunk_that_is_vetoed_is_not_begun() {
    let mut bench = Bench::armed(vetoing(false));
    let now = bench.at(0);
    bench.step.assessment(&assessment(0, 0.1), now);
    let (reason, text) = bench.refused(0, &chunk(0, 0.02, 10));
    assert_eq!(reason, "vetoed");
    assert!(text.contains("success probability is 0.10"), "{text}");
    assert_eq!(bench.run(0, 300), None);
    let status = bench.step.status();
    assert!(status.reason.contains("vetoed"), "{}", status.reason);
    assert_eq!((status.counts.vetoed, status.counts.refused), (1, 1));
    bench.offer(300, &chunk(300, 0.02, 10)).unwrap();
    assert!(bench.run(350, 500).is_some());
}

#[test]
fn an_assessment_that_comes_later_stops_its_chunk() {
    let mut bench = Bench::moving(vetoing(false));
    let now = bench.at(420);
    assert!(bench.step.assessment(&assessment(5, 0.1), now).is_empty());
    let refused = bench.step.assessment(&assessment(0, 0.1), now);
    assert!(matches!(
        refused[..],
        [Refusal::Vetoed(Veto::Success { .. })]
    ));
    bench.expect_stop(450);
    assert_eq!(bench.step.status().counts.interrupted, 1);
    assert!(bench.reason().contains("vetoed"), "{}", bench.reason());
}

#[test]
fn a_chunk_waits_for_its_assessment_where_it_must() {
    let mut bench = Bench::armed(vetoing(true));
    assert_eq!(bench.offer(0, &chunk(0, 0.02, 10)), Ok(Taken::Waiting));
    assert_eq!(bench.run(0, 100), None);
    let now = bench.at(120);
    assert_eq!(bench.step.assessment(&assessment(0, 0.9), now), []);
    assert!(bench.run(150, 250).unwrap() > 0.0);
    // The next one's never comes.
    assert_eq!(bench.offer(300, &chunk(300, 0.02, 10)), Ok(Taken::Waiting));
    bench.run(300, 600);
    let now = bench.at(650);
    let refused = bench.step.tick(now).refused;
    assert!(matches!(refused[..], [Refusal::Unassessed { .. }]));
    // Of those that wait, the oldest go first.
    for index in 0..10 {
        let stamp_ms = 700 + index;
        let taken = bench.offer(700, &chunk(stamp_ms, 0.02, 10));
        assert_eq!(taken, Ok(Taken::Waiting));
    }
    assert_eq!(bench.step.status().counts.refused, 3);
}

#[test]
fn a_model_that_predicts_badly_vetoes_plans_too() {
    let mut settings = settings();
    settings.veto.error_ratio = 1.5;
    let mut bench = Bench::armed(settings);
    for _ in 0..2 {
        bench.step.prediction_error(&PredictionError {
            mse: 2.0,
            persistence_mse: 1.0,
            ..PredictionError::default()
        });
    }
    let now = bench.at(0);
    let refused = bench.step.plan(&plan(0, 1), now, now).unwrap_err();
    assert!(
        refused
            .to_string()
            .contains("2.00 times those of persistence")
    );
    bench.step.reset().unwrap();
    bench.tick(0);
    bench.step.arm().unwrap();
    assert_eq!(bench.step.plan(&plan(0, 1), now, now), Ok(Taken::Accepted));
}
