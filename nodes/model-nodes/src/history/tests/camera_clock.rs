//! A camera whose clock jumps while that of the actions goes on.

use super::*;

/// A robot by the clock of a machine, and its camera.
struct Robot {
    history: History,
    begin: Instant,
}

impl Robot {
    fn new() -> Self {
        Self {
            history: history(2),
            begin: Instant::now(),
        }
    }

    /// Frame and action of one moment; the camera's clock is so many frames off.
    fn moment(&mut self, index: i64, camera: i64) -> Result<Arrival, HistoryError> {
        self.history
            .action(&action(index, 0.01 * (index % 5) as f32), stamp(index))
            .unwrap();
        self.frame(index, camera)
    }

    fn frame(&mut self, index: i64, camera: i64) -> Result<Arrival, HistoryError> {
        let reception = Reception {
            stamp: stamp(index),
            at: self.begin + Duration::from_nanos((index * PERIOD) as u64),
            ..reception()
        };
        let latent = latent(stamp(index + camera), "camera", index as f32);
        self.history.latent(&latent, reception)
    }

    fn moments(&mut self, span: std::ops::Range<i64>, camera: i64) {
        for index in span {
            self.moment(index, camera).unwrap();
        }
    }
}

#[test]
fn camera_clock_that_steps_back_is_named_and_predictions_go_on() {
    for back in [-20, -18_000, -8_000_000_000] {
        let mut robot = Robot::new();
        robot.moments(0..20, 0);
        let epoch = robot.history.epoch();
        assert!(robot.moment(20, back).unwrap().held_back);
        let arrival = robot.moment(21, back).unwrap();
        assert!(arrival.flushed && robot.history.epoch() > epoch, "{back}");
        let text = arrival.camera_step.unwrap().to_string();
        let seconds = back.unsigned_abs() as f64 / 5.0;
        assert!(
            text.starts_with(&format!(
                "the camera's clock stepped back by {seconds:.1} s"
            )),
            "{text}"
        );
        robot.moments(22..30, back);
        let moment = robot.history.moment().unwrap();
        assert_eq!(
            metres(&moment.past),
            [0.02, 0.03],
            "those between frames 27 and 29"
        );
        let wait = moment.expect_fresh(moment.observed.reception.at, Duration::from_secs(1));
        assert!(matches!(wait, Err(Wait::CameraClock(_))), "{wait:?}");
    }
}

#[test]
fn camera_clock_that_comes_back_is_trusted_again() {
    let mut robot = Robot::new();
    robot.moments(0..20, 0);
    for index in 20..30 {
        let _ = robot.moment(index, -500);
    }
    assert!(robot.history.camera_step().is_some());
    for index in 30..40 {
        let _ = robot.moment(index, 0);
    }
    assert_eq!(robot.history.camera_step(), None);
    let moment = robot.history.moment().unwrap();
    assert_eq!(metres(&moment.past), [0.02, 0.03]);
    let fresh = moment.expect_fresh(moment.observed.reception.at, Duration::from_secs(1));
    assert_eq!(fresh, Ok(()));
}

#[test]
fn camera_clock_that_steps_forward_is_ahead_of_the_clock() {
    let mut robot = Robot::new();
    robot.moments(0..20, 0);
    for index in 20..30 {
        let error = robot.moment(index, 25).unwrap_err();
        assert!(error.to_string().contains("5.00 s ahead"), "{error}");
    }
    assert_eq!(robot.history.camera_step(), None);
}

#[test]
fn time_that_jumps_for_all_is_not_the_cameras() {
    let mut history = history(2);
    let see = |history: &mut History, index: i64, now: i64| {
        history.action(&action(index, 0.01), stamp(now)).unwrap();
        let reception = Reception {
            stamp: stamp(now),
            ..reception()
        };
        let latent = latent(stamp(index), "camera", index as f32);
        history.latent(&latent, reception).unwrap()
    };
    for index in 0..50 {
        see(&mut history, index, 1000 + index);
    }
    // A bag that is played again, with its own stamps.
    let flushed: Vec<_> = (0..10)
        .map(|index| see(&mut history, index, 1050 + index))
        .filter(|arrival| arrival.flushed)
        .collect();
    assert_eq!(flushed.len(), 1);
    assert_eq!(flushed[0].camera_step, None);
    assert!(history.moment().is_ok());
}

#[test]
fn camera_far_behind_the_clock_is_named_and_not_the_arm() {
    let mut robot = Robot::new();
    robot.frame(0, -5000).unwrap();
    let error = robot.history.action(&action(1, 0.0), stamp(1)).unwrap_err();
    assert_eq!(error.reason(), "camera_clock");
    let text = error.to_string();
    assert!(
        text.contains("the camera's stamps are 1000.0 s behind this node's clock"),
        "{text}"
    );
}
