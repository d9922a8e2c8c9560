mod camera;
mod clock;
mod emergency;
mod joints;
mod lateness;
mod malformed;
mod vetoes;

use super::*;
use crate::executor::{
    Begin, Bounds, Camera, ClockWatch, Deadman, EmergencyStop, Joints, Layout, Limits, PoseError,
    State, VetoSettings, Workspace,
};
use wm_motion::actions::ActionSpace;
use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    geometry_msgs::Point,
    wm_msgs::{Action, ActionChunk, Assessment, Plan, PredictionError},
};

const MS: i64 = 1_000_000;
/// The publisher of the emergency stop.
const BUTTON: wm_ros::PublisherId = wm_ros::PublisherId([1; 16]);
/// When the tests begin, by the node's clock \[ns\].
const START: i64 = 1_700_000_000_000_000_000;
/// Time from one command to the next \[ms\].
const PERIOD_MS: i64 = 50;

pub(super) fn settings() -> Settings {
    Settings {
        layout: Layout::new(ActionSpace::bridge()).unwrap(),
        base_frame: String::new(),
        period: Duration::from_millis(50),
        bounds: Bounds {
            translation: 0.1,
            rotation: 0.5,
            joints: Vec::new(),
            interval: Duration::from_millis(200),
            periods: Duration::from_millis(5)..=Duration::from_secs(2),
        },
        limits: Limits::end_effector((0.25, 2.0), (1.25, 10.0)),
        max_age: Duration::from_secs(2),
        begin: Begin::Stamp,
        max_lead: Duration::from_secs(5),
        stop_within: Duration::from_millis(200),
        zero_for: Duration::from_millis(500),
        dry_run: true,
        workspace: None,
        joints: None,
        deadman: None,
        clock: ClockWatch::new(Duration::from_millis(1_500)),
        camera: Camera::new(Duration::from_secs(1)),
        emergency: EmergencyStop::new(false),
        veto: VetoSettings {
            cost_rise: 0.0,
            min_success: 0.0,
            is_required: false,
            wait: Duration::from_millis(300),
            error_ratio: 0.0,
            error_window: 2,
        },
    }
}

/// A chunk of 200 ms actions that all move forward.
pub(super) fn chunk(stamp_ms: i64, forward: f32, count: usize) -> ActionChunk {
    let mut chunk = ActionChunk {
        period: RosDuration::from_nanos(200 * MS),
        ..ActionChunk::default()
    };
    chunk.header.stamp = Time::from_nanos(START + stamp_ms * MS);
    chunk.header.frame_id = "base_link".into();
    let action = Action {
        header: chunk.header.clone(),
        values: vec![forward, 0.0, 0.0, 0.0, 0.0, 0.1, 1.0],
    };
    chunk.actions = vec![action; count];
    chunk
}

fn plan(stamp_ms: i64, epoch: u64) -> Plan {
    let chunk = chunk(stamp_ms, 0.02, 2);
    Plan {
        actions: chunk.actions,
        period: chunk.period,
        epoch,
        ..Plan::default()
    }
}

fn pose(x: f64) -> PoseStamped {
    let mut pose = PoseStamped::default();
    pose.header.frame_id = "base_link".into();
    pose.pose.position = Point { x, y: 0.0, z: 0.0 };
    pose
}

pub(super) struct Bench {
    pub step: ExecutorStep,
    start: Instant,
}

impl Bench {
    pub fn new(settings: Settings) -> Self {
        Self {
            step: ExecutorStep::new(settings),
            start: Instant::now(),
        }
    }

    fn armed(settings: Settings) -> Self {
        let mut bench = Self::new(settings);
        bench.step.arm().unwrap();
        bench
    }

    pub fn at(&self, ms: i64) -> Moment {
        let at = self.start + Duration::from_millis(ms.unsigned_abs());
        Moment::real(at, START + ms * MS)
    }

    pub fn offer(&mut self, ms: i64, chunk: &ActionChunk) -> Result<Taken, Refusal> {
        let now = self.at(ms);
        self.step.chunk(chunk, now, now)
    }

    fn refused(&mut self, ms: i64, chunk: &ActionChunk) -> (&'static str, String) {
        let refusal = self.offer(ms, chunk).unwrap_err();
        (refusal.reason(), refusal.to_string())
    }

    pub fn tick(&mut self, ms: i64) -> Output {
        let now = self.at(ms);
        self.step.tick(now).output
    }

    /// Ticks from one time up to another; returns the last command's forward velocity, or `None` if nothing is sent.
    fn run(&mut self, from_ms: i64, to_ms: i64) -> Option<f64> {
        let mut last = None;
        let mut ms = from_ms;
        while ms <= to_ms {
            last = sent(self.tick(ms));
            ms += PERIOD_MS;
        }
        last
    }

    /// Moves forward at 0.1 m/s from time 0 on; the next tick is at 450 ms.
    fn moving(settings: Settings) -> Self {
        let mut bench = Self::armed(settings);
        bench.set_going();
        bench
    }

    fn set_going(&mut self) {
        assert_eq!(self.offer(0, &chunk(0, 0.02, 20)), Ok(Taken::Accepted));
        let forward = self.run(0, 400).unwrap();
        assert!((forward - 0.1).abs() < 1e-6, "{forward}");
        assert_eq!(self.state(), State::Executing);
    }

    /// That it decelerates within the limits to zero within 200 ms, sends zeros for half a second, and is then silent.
    fn expect_stop(&mut self, from_ms: i64) {
        let mut before = 0.1;
        let mut ms = from_ms;
        while ms < from_ms + 200 {
            let forward = sent(self.tick(ms)).unwrap();
            assert!(
                (0.0..=before).contains(&forward),
                "{forward} after {before}"
            );
            assert!(before - forward <= 2.0 * 0.05 + 1e-9);
            before = forward;
            ms += PERIOD_MS;
        }
        assert_eq!(self.run(ms, ms + 200), Some(0.0));
        assert_eq!(self.run(ms + 250, ms + 1000), None);
    }

    fn state(&self) -> State {
        self.step.status().state
    }

    fn reason(&self) -> String {
        self.step.status().reason
    }
}

fn sent(output: Output) -> Option<f64> {
    match output {
        Output::Send(command) => Some(command.velocity.as_slice()[0]),
        Output::Silent | Output::Preview(_) => None,
    }
}

#[test]
fn a_chunk_is_executed_as_velocity_and_gripper() {
    let mut bench = Bench::moving(settings());
    let Output::Send(command) = bench.tick(450) else {
        panic!("nothing is sent")
    };
    assert!((command.velocity.as_slice()[5] - 0.5).abs() < 1e-6);
    assert_eq!(command.gripper, Some(1.0));
    let status = bench.step.status();
    assert_eq!((status.reason.as_str(), status.counts.begun), ("", 1));
    assert_eq!(status.offer_ns, Some(START));
    assert_eq!(bench.step.frame_id(), "base_link");
}

#[test]
fn before_it_is_armed_commands_are_only_shown() {
    let mut bench = Bench::new(settings());
    bench.offer(0, &chunk(0, 0.02, 10)).unwrap();
    let mut is_shown = false;
    for tick in 0..10 {
        match bench.tick(tick * PERIOD_MS) {
            Output::Preview(command) => is_shown |= command.velocity.as_slice()[0] > 0.09,
            Output::Silent => {}
            Output::Send(command) => panic!("{command:?} is sent"),
        }
    }
    assert!(is_shown);
    assert_eq!(bench.state(), State::DryRun);
    // What was tried out is not gone on with.
    bench.step.arm().unwrap();
    assert_eq!(bench.run(500, 900), None);
    assert_eq!(bench.state(), State::Idle);

    let mut bench = Bench::new(Settings {
        dry_run: false,
        ..settings()
    });
    assert_eq!(bench.refused(0, &chunk(0, 0.02, 10)).0, "not_armed");
}

#[test]
fn silence_stops_it() {
    let mut bench = Bench::armed(settings());
    bench.offer(0, &chunk(0, 0.02, 2)).unwrap();
    let forward = bench.run(0, 350).unwrap();
    assert!((forward - 0.1).abs() < 1e-6);
    bench.expect_stop(400);
    assert_eq!(bench.state(), State::Idle);
    assert!(
        bench.reason().contains("none followed"),
        "{}",
        bench.reason()
    );
}

#[test]
fn what_cannot_be_executed_is_refused_by_name() {
    let mut bench = Bench::armed(Settings {
        base_frame: "base_link".into(),
        ..settings()
    });
    let of = |change: &dyn Fn(&mut ActionChunk)| {
        let mut chunk = chunk(0, 0.02, 3);
        change(&mut chunk);
        chunk
    };
    let set = |index: usize, value: f32| of(&move |chunk| chunk.actions[1].values[index] = value);
    for (bad, reason, named) in [
        (set(0, f32::NAN), "not_finite", "action 1: value 0"),
        (set(3, f32::INFINITY), "not_finite", "action 1: value 3"),
        (
            set(2, 0.11),
            "out_of_bounds",
            "dz is 0.1100 m; at most 0.1000 is allowed in 0.2 s",
        ),
        (set(5, -0.6), "out_of_bounds", "dyaw is -0.6000 rad"),
        (set(0, 1e30), "out_of_bounds", "dx"),
        (set(6, 1.5), "out_of_bounds", "gripper is 1.5"),
        (
            of(&|chunk| chunk.actions.clear()),
            "action_count",
            "0 actions",
        ),
        (
            of(&|chunk| chunk.actions[2].values.truncate(6)),
            "wrong_length",
            "6 values; expected 7",
        ),
        (
            of(&|chunk| chunk.period = RosDuration::from_nanos(MS)),
            "period",
            "0.001 s; expected 0.005 to 2 s",
        ),
        (
            of(&|chunk| chunk.period = RosDuration::from_nanos(-200 * MS)),
            "period",
            "-0.2 s",
        ),
        (
            of(&|chunk| chunk.header.frame_id = "camera".into()),
            "wrong_frame",
            "\"camera\"; expected base_frame, \"base_link\"",
        ),
    ] {
        let (found, text) = bench.refused(0, &bad);
        assert_eq!(found, reason, "{text}");
        assert!(text.contains(named), "{text}");
    }
    assert_eq!(bench.step.status().counts.refused, 11);
    assert_eq!(bench.run(0, 300), None);
    assert!(
        bench.reason().contains("last refused"),
        "{}",
        bench.reason()
    );
}

#[test]
fn a_longer_action_may_move_further() {
    let mut bench = Bench::armed(settings());
    let of = |forward: f32, period_ms: i64| ActionChunk {
        period: RosDuration::from_nanos(period_ms * MS),
        ..chunk(0, forward, 2)
    };
    // A model step of 0.8 s, as a planner tells it.
    assert_eq!(bench.offer(0, &of(0.39, 800)), Ok(Taken::Accepted));
    let (reason, text) = bench.refused(0, &of(0.41, 800));
    assert_eq!(reason, "out_of_bounds");
    assert!(
        text.contains("at most 0.4000 is allowed in 0.8 s"),
        "{text}"
    );
    // As far as an action of 0.2 s may move, in a tenth of the time.
    assert_eq!(bench.refused(0, &of(0.09, 20)).0, "out_of_bounds");
}

#[test]
fn what_comes_at_the_wrong_time_is_refused() {
    let mut bench = Bench::armed(settings());
    let now = bench.at(10_000);
    let received = bench.at(7_900);
    let stale = bench.step.chunk(&chunk(10_000, 0.02, 4), received, now);
    assert_eq!(stale.unwrap_err().reason(), "stale");
    let unknown = Moment { stamp_ns: 0, ..now };
    let early = bench.step.chunk(&chunk(0, 0.02, 4), now, unknown);
    assert_eq!(early, Err(Refusal::NoClock));
    assert_eq!(bench.refused(10_000, &chunk(9_600, 0.02, 2)).0, "late");
    assert_eq!(bench.refused(10_000, &chunk(15_001, 0.02, 2)).0, "early");
    bench.offer(10_000, &chunk(10_000, 0.02, 4)).unwrap();
    bench.run(10_000, 10_200);
    assert_eq!(bench.refused(10_200, &chunk(9_999, 0.02, 9)).0, "older");
    assert_eq!(bench.state(), State::Executing);
}

#[test]
fn a_plan_of_an_older_epoch_is_refused() {
    let mut bench = Bench::armed(settings());
    let mut offer = |ms: i64, plan: &Plan| {
        let now = bench.at(ms);
        bench.step.plan(plan, now, now)
    };
    assert_eq!(offer(0, &plan(0, 7)), Ok(Taken::Accepted));
    let refused = offer(50, &plan(50, 6)).unwrap_err();
    assert_eq!(
        refused,
        Refusal::Epoch {
            newest: 7,
            actual: 6
        }
    );
    assert_eq!(offer(50, &plan(50, 8)), Ok(Taken::Accepted));
}

#[test]
fn a_new_chunk_takes_over_without_a_jump() {
    let mut bench = Bench::moving(settings());
    bench.offer(450, &chunk(250, -0.02, 20)).unwrap();
    let mut before = 0.1;
    for tick in 9..13 {
        let forward = sent(bench.tick(tick * PERIOD_MS)).unwrap();
        assert!((before - forward).abs() <= 0.1 + 1e-6);
        before = forward;
    }
    assert!((before + 0.1).abs() < 1e-6, "{before}");
    assert_eq!(bench.step.status().counts.begun, 2);
}

#[test]
fn a_slow_policy_without_times_begins_at_reception() {
    let mut bench = Bench::armed(Settings {
        begin: Begin::Reception,
        ..settings()
    });
    for ms in [400, 600] {
        bench.offer(ms, &chunk(ms - 400, 0.02, 1)).unwrap();
        assert!(bench.run(ms, ms + 150).unwrap() > 0.09);
    }
    assert_eq!(bench.refused(800, &chunk(100, 0.02, 9)).0, "older");
    bench.expect_stop(800);
    let (reason, text) = bench.refused(3000, &chunk(900, 0.02, 1));
    assert_eq!(reason, "stale", "{text}");
}

#[test]
fn what_is_too_fast_is_slowed_down() {
    let mut bench = Bench::armed(settings());
    bench.offer(0, &chunk(0, 0.09, 10)).unwrap();
    let forward = bench.run(0, 500).unwrap();
    assert!((forward - 0.25).abs() < 1e-9, "{forward}");
    assert!(bench.reason().contains("slowed"), "{}", bench.reason());
}

#[test]
fn disarming_stops_it_and_then_nothing_is_sent() {
    let mut bench = Bench::moving(settings());
    bench.step.disarm(Cause::Disarmed);
    assert_eq!(bench.state(), State::Stopping);
    assert_eq!(bench.refused(450, &chunk(450, 0.02, 20)).0, "not_armed");
    bench.tick(450);
    assert_eq!(bench.step.arm(), Err(ArmError::Stopping));
    bench.expect_stop(500);
    assert_eq!(bench.state(), State::DryRun);
    bench.offer(1800, &chunk(1800, 0.02, 20)).unwrap();
    assert_eq!(bench.run(1800, 2200), None);
}

#[test]
fn the_emergency_stop_is_at_once_and_latches() {
    let mut bench = Bench::moving(settings());
    bench.step.emergency(BUTTON, true);
    assert_eq!(sent(bench.tick(401)), Some(0.0));
    assert_eq!(bench.refused(450, &chunk(450, 0.02, 20)).0, "stopped");
    assert_eq!(bench.step.arm(), Err(ArmError::Stopped));
    assert_eq!(bench.run(450, 850), Some(0.0));
    assert_eq!(bench.run(950, 1200), None);
    bench.step.emergency(BUTTON, false);
    assert_eq!(bench.state(), State::Stopped);
    bench.step.emergency(BUTTON, true);
    assert_eq!(bench.step.reset(), Err(ArmError::Pressed));
    bench.step.emergency(BUTTON, false);
    bench.step.reset().unwrap();
    assert_eq!(bench.state(), State::DryRun);
    bench.offer(1300, &chunk(1300, 0.02, 20)).unwrap();
    assert_eq!(bench.run(1300, 1500), None);
    bench.step.arm().unwrap();
    bench.offer(1550, &chunk(1550, 0.02, 20)).unwrap();
    assert!(bench.run(1550, 1700).unwrap() > 0.09);
}

#[test]
fn an_emergency_stop_while_not_armed_sends_nothing() {
    let mut bench = Bench::new(settings());
    assert!(bench.step.stop("somebody called ~/stop"));
    assert_eq!(bench.run(0, 500), None);
    // Who it was is known after the stop; a second one changes nothing.
    bench.step.name_stopper("/wm/view called ~/stop".to_owned());
    assert!(!bench.step.stop("the node ends"));
    assert_eq!(
        bench.reason(),
        "/wm/view called ~/stop; to go on, call ~/reset, then ~/arm"
    );
}

#[test]
fn without_the_deadman_it_stops() {
    let mut bench = Bench::armed(Settings {
        deadman: Some(Deadman::new(Duration::from_secs(1))),
        ..settings()
    });
    assert_eq!(bench.refused(0, &chunk(0, 0.02, 20)).0, "deadman");
    bench.step.deadman(true, bench.start);
    bench.set_going();
    bench.step.deadman(false, bench.at(440).at);
    bench.expect_stop(450);
    assert!(
        bench.reason().contains("deadman is false"),
        "{}",
        bench.reason()
    );
    // Held again, it waits for a new chunk.
    bench.step.deadman(true, bench.at(1900).at);
    assert_eq!(bench.run(1900, 2000), None);
    bench.offer(2000, &chunk(2000, 0.02, 20)).unwrap();
    assert!(bench.run(2050, 2800).unwrap() > 0.09);
    // And a switch that falls silent is let go.
    assert!(bench.run(2850, 3200).unwrap() < 0.01);
    assert!(
        bench.reason().contains("deadman_timeout"),
        "{}",
        bench.reason()
    );
    assert_eq!(bench.step.status().counts.interrupted, 2);
}

fn in_a_box() -> Settings {
    let (lookahead, timeout) = (Duration::from_millis(300), Duration::from_millis(200));
    Settings {
        base_frame: "base_link".into(),
        workspace: Some(Workspace::new([-1.0; 3], [1.0; 3], lookahead, timeout)),
        ..settings()
    }
}

#[test]
fn with_a_box_and_no_pose_it_stops() {
    let mut bench = Bench::armed(in_a_box());
    assert_eq!(bench.refused(0, &chunk(0, 0.02, 20)).0, "no_pose");
    let mut wrong = pose(0.0);
    wrong.header.frame_id = "camera".into();
    let refused = bench.step.pose(&wrong, bench.at(0)).unwrap_err();
    assert!(matches!(refused, PoseError::Frame { .. }));
    bench.step.pose(&pose(0.0), bench.at(210)).unwrap();
    bench.set_going();
    bench.expect_stop(450);
    assert!(
        bench.reason().contains("pose_timeout"),
        "{}",
        bench.reason()
    );
}

#[test]
fn fresh_messages_with_old_poses_do_not_move_the_arm() {
    let mut bench = Bench::armed(in_a_box());
    // `pose_timeout` is 0.2 s; the last one is of a clock that began with the driver.
    for stamp_ns in [START - 201 * MS, START - 3_600_000 * MS, 5_000 * MS] {
        let mut old = pose(0.0);
        old.header.stamp = Time::from_nanos(stamp_ns);
        bench.step.pose(&old, bench.at(0)).unwrap();
        let (reason, text) = bench.refused(0, &chunk(0, 0.02, 20));
        assert_eq!(reason, "old_pose", "{text}");
    }
    // While it moves, the robot's measurements begin to come late.
    let mut last = 0.0;
    for ms in (0..1_000).step_by(50) {
        let late_ms = if ms < 400 { 20 } else { 250 };
        let mut pose = pose(0.0);
        pose.header.stamp = Time::from_nanos(START + (ms - late_ms) * MS);
        bench.step.pose(&pose, bench.at(ms)).unwrap();
        if ms == 0 {
            bench.offer(0, &chunk(0, 0.02, 20)).unwrap();
        }
        last = sent(bench.tick(ms)).unwrap_or(0.0);
        assert!(ms != 350 || last > 0.09, "{last}");
        assert!(ms < 600 || last == 0.0, "{last} at {ms} ms");
    }
    assert_eq!(last, 0.0);
    assert_eq!(bench.step.status().hold, Some("old_pose"));
    assert!(
        bench.reason().contains("behind this node's clock"),
        "{}",
        bench.reason()
    );
}

#[test]
fn the_arm_stays_in_its_box() {
    let mut bench = Bench::armed(in_a_box());
    let mut x = 0.95;
    for tick in 0..60 {
        let ms = tick * PERIOD_MS;
        bench.step.pose(&pose(x), bench.at(ms)).unwrap();
        if tick % 10 == 0 {
            bench.offer(ms, &chunk(ms, 0.05, 10)).unwrap();
        }
        x += sent(bench.tick(ms)).unwrap() * 0.05;
        assert!(x <= 1.0, "{x} m after {ms} ms");
    }
    assert!(x > 0.99, "{x}");
    assert!(bench.reason().contains("ends at x"), "{}", bench.reason());
    // Back is free.
    bench.offer(3000, &chunk(3000, -0.02, 10)).unwrap();
    bench.step.pose(&pose(x), bench.at(3000)).unwrap();
    assert!(bench.run(3000, 3100).unwrap() < -0.09);
}
