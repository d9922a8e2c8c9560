//! Properties of the simulated arm.

use wm_msgs::std_msgs::Header;

use super::*;
use crate::executor::Layout;
use wm_motion::actions::ActionSpace;

const STEP_NS: i64 = 200_000_000;

fn settings(task: GoalKind, seed: u64) -> Settings {
    Settings {
        task,
        seed,
        command_timeout: Duration::from_millis(500),
        base_frame: "base_link".into(),
        goal_every: None,
        camera: CameraSettings::default(),
        has_front_camera: false,
    }
}

fn arm(task: GoalKind, seed: u64) -> SimArmStep {
    SimArmStep::new(settings(task, seed)).unwrap()
}

fn twist_of(velocity: Velocity) -> TwistStamped {
    let mut twist = TwistStamped::default();
    let [x, y, z] = velocity.linear;
    (twist.twist.linear.x, twist.twist.linear.y) = (x, y);
    twist.twist.linear.z = z;
    let [x, y, z] = velocity.angular;
    (twist.twist.angular.x, twist.twist.angular.y) = (x, y);
    twist.twist.angular.z = z;
    twist
}

/// 0.1 m/s along each axis, towards the middle of the workspace, where no limit applies.
fn inwards(arm: &SimArmStep) -> Velocity {
    let position = arm.environment.world().tool().position;
    let [least, most] = wm_sim::WORKSPACE_M;
    let middle = (Vector3::from(least) + Vector3::from(most)) / 2.0;
    // Upwards, away from the objects.
    let [x, y, _]: [f64; 3] = (middle - position).map(|v| 0.1 * v.signum()).into();
    Velocity {
        linear: [x, y, 0.0],
        angular: [0.0; 3],
    }
}

fn action(values: Vec<f32>) -> Action {
    Action {
        header: Header::default(),
        values,
    }
}

#[test]
fn a_twist_becomes_its_displacement_until_it_is_too_old() {
    let mut arm = arm(GoalKind::Reach, 3);
    let start = arm.tick(0);
    assert_eq!((start.done, start.success), (None, Some(false)));
    let velocity = inwards(&arm);
    arm.twist(&twist_of(velocity), 0).unwrap();
    arm.gripper(&Float64 { data: 0.0 }).unwrap();
    let step = Vector3::from(velocity.linear) * STEP_S;
    // 0.2 and 0.4 s after the command.
    for count in 1..=2 {
        let tick = arm.tick(i64::from(count) * STEP_NS);
        let moved = tick.tool.position - start.tool.position;
        assert!((moved - step * f64::from(count)).norm() < 1e-9, "{moved}");
        let done = tick.done.unwrap();
        assert!((done.action.translation - step).norm() < 1e-9);
        assert_eq!(done.stamp_ns, i64::from(count - 1) * STEP_NS);
        assert_eq!((tick.problem, tick.success), (None, None));
    }
    let before = arm.tick(3 * STEP_NS);
    let after = arm.tick(4 * STEP_NS);
    for tick in [&before, &after] {
        let done = tick.done.unwrap().action;
        assert_eq!((done.translation.norm(), done.gripper), (0.0, 0.0));
    }
    assert_eq!(after.opening, 0.0);
    // The next command moves it again.
    arm.twist(&twist_of(velocity), 4 * STEP_NS).unwrap();
    let tick = arm.tick(5 * STEP_NS);
    assert!(tick.done.unwrap().action.translation.norm() > 0.02);
}

#[test]
fn of_several_twists_in_a_step_each_counts_for_its_time() {
    let mut arm = arm(GoalKind::Reach, 3);
    let velocity = inwards(&arm);
    // A command before the first step.
    arm.twist(&twist_of(velocity), -STEP_NS / 2).unwrap();
    arm.tick(0);
    arm.twist(&twist_of(Velocity::ZERO), STEP_NS / 4).unwrap();
    let step = Vector3::from(velocity.linear) * STEP_S;
    let done = arm.tick(STEP_NS).done.unwrap().action;
    assert!((done.translation - step / 4.0).norm() < 1e-9, "{done:?}");
    arm.twist(&twist_of(velocity), STEP_NS * 3 / 2).unwrap();
    let done = arm.tick(2 * STEP_NS).done.unwrap().action;
    assert!((done.translation - step / 2.0).norm() < 1e-9, "{done:?}");
    // A late tick does not make the step longer.
    let done = arm.tick(3 * STEP_NS + STEP_NS / 2).done.unwrap().action;
    assert!((done.translation - step).norm() < 1e-9, "{done:?}");
}

#[test]
fn motions_add_up_within_a_step_and_are_done_once() {
    let mut arm = arm(GoalKind::Reach, 3);
    arm.tick(0);
    let [x, y, _] = inwards(&arm).linear;
    let (x, y) = ((x * 0.05) as f32, (y * 0.05) as f32);
    for at in 1..=4 {
        let motion = action(vec![x, y, 0.0, 0.0, 0.0, 0.01, 0.0]);
        arm.action(&motion, at * STEP_NS / 4).unwrap();
    }
    let done = arm.tick(STEP_NS).done.unwrap().action;
    let expected = Vector3::new(f64::from(4.0 * x), f64::from(4.0 * y), 0.0);
    assert!((done.translation - expected).norm() < 1e-7, "{done:?}");
    assert!((done.rotation.z - 0.04).abs() < 1e-7, "{done:?}");
    let done = arm.tick(2 * STEP_NS).done.unwrap().action;
    assert_eq!(done, EndEffectorAction::still(0.0));
    // A command that waits for longer than the timeout.
    arm.action(&action(vec![0.01; 7]), 2 * STEP_NS).unwrap();
    let tick = arm.tick(6 * STEP_NS);
    assert_eq!(tick.problem.unwrap().reason(), "stale");
    assert_eq!(tick.done.unwrap().action.translation.norm(), 0.0);
}

#[test]
fn invalid_command_is_refused_and_the_previous_one_holds() {
    let mut arm = arm(GoalKind::Push, 5);
    arm.tick(0);
    let velocity = inwards(&arm);
    arm.twist(&twist_of(velocity), 0).unwrap();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut twist = twist_of(velocity);
        twist.twist.angular.y = bad;
        let refused = arm.twist(&twist, 1).unwrap_err();
        assert_eq!(refused.reason(), "not_finite");
        assert!(arm.gripper(&Float64 { data: bad }).is_err());
        let mut values = vec![0.0; 7];
        values[6] = bad as f32;
        assert!(arm.action(&action(values), 1).is_err());
        let mut array = Float64MultiArray {
            data: vec![bad; 6],
            ..Float64MultiArray::default()
        };
        assert_eq!(arm.velocity(&array, 1).unwrap_err().reason(), "not_finite");
        array.data.pop();
        assert_eq!(
            arm.velocity(&array, 1).unwrap_err().reason(),
            "wrong_length"
        );
    }
    assert!(arm.action(&action(vec![0.0; 6]), 1).is_err());
    let mut elsewhere = twist_of(velocity);
    elsewhere.header.frame_id = "camera".into();
    let refused = arm.twist(&elsewhere, 1).unwrap_err();
    assert!(refused.to_string().contains("\"camera\""), "{refused}");
    let done = arm.tick(STEP_NS).done.unwrap().action;
    let step = Vector3::from(velocity.linear) * STEP_S;
    assert!((done.translation - step).norm() < 1e-9);
}

#[test]
fn what_is_too_fast_is_limited_and_said() {
    let mut arm = arm(GoalKind::Reach, 3);
    arm.tick(0);
    let velocity = inwards(&arm);
    for (scale, reason) in [(10.0, "out_of_bounds"), (f64::MAX, "not_finite")] {
        let fast = Velocity {
            linear: velocity.linear.map(|v| v * scale),
            angular: [scale, scale, scale],
        };
        arm.twist(&twist_of(fast), arm.last_ns.unwrap()).unwrap();
        let tick = arm.tick(arm.last_ns.unwrap() + STEP_NS);
        assert_eq!(tick.problem.unwrap().reason(), reason);
        let done = tick.done.unwrap().action;
        assert!(done.translation.amax() < LARGEST_STEP_M + ROUNDING);
        assert!(tick.tool.position.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn a_seed_gives_the_same_pictures_again() {
    let mut arm = arm(GoalKind::Push, 5);
    let velocity = inwards(&arm);
    let run = |arm: &mut SimArmStep| -> Vec<Tick> {
        let tick = |count: i64| {
            let sent = arm.twist(&twist_of(velocity), count * STEP_NS);
            sent.unwrap();
            arm.tick(count * STEP_NS)
        };
        (0..4).map(tick).collect()
    };
    let first = run(&mut arm);
    assert_eq!(first[0].frames.len(), 1);
    assert!(first[1].frames != first[0].frames);
    arm.reset(GoalKind::Push, 5).unwrap();
    assert!(run(&mut arm) == first);
    arm.reset(GoalKind::Reach, 6).unwrap();
    let words = arm.instruction().to_owned();
    assert_eq!(words, self::arm(GoalKind::Reach, 6).instruction());
    assert!(arm.tick(0).frames != first[0].frames);
    arm.reset(GoalKind::Push, 5).unwrap();
    assert!(run(&mut arm) == first);
}

#[test]
fn oracle_reaches_the_goal_by_actions_and_by_twists() {
    let layout = Layout::new(ActionSpace::bridge()).unwrap();
    for task in GoalKind::ALL {
        for is_twist in [false, true] {
            let mut arm = arm(task, 2);
            let mut now_ns = 0;
            assert_eq!(arm.tick(now_ns).success, Some(false));
            let most = 2 * arm.environment.solution().len() + 10;
            let success = (0..most).find_map(|_| {
                let oracle = arm.environment.oracle();
                let values = oracle.values().to_vec();
                if is_twist {
                    let velocity = layout.velocity(&values, STEP_S);
                    arm.twist(&twist_of(velocity), now_ns).unwrap();
                    let data = oracle.gripper;
                    arm.gripper(&Float64 { data }).unwrap();
                } else {
                    arm.action(&action(values), now_ns).unwrap();
                }
                now_ns += STEP_NS;
                let tick = arm.tick(now_ns);
                assert_eq!(tick.problem, None);
                assert!(tick.joints.is_some());
                tick.success.map(|is_success| (is_success, tick.distance_m))
            });
            let (is_success, distance_m) = success.unwrap();
            assert!(is_success && distance_m < 0.03, "{task} {distance_m}");
            arm.reset(task, 2).unwrap();
            assert_eq!(arm.tick(now_ns).success, Some(false));
        }
    }
}

#[test]
fn clock_jump_drops_commands_and_pictures() {
    let mut settings = settings(GoalKind::Reach, 3);
    settings.camera.latency = Duration::from_secs(1);
    let mut arm = SimArmStep::new(settings).unwrap();
    assert!(arm.tick(10 * STEP_NS).frames.is_empty());
    assert_eq!(arm.next_frame_ns(), Some(15 * STEP_NS));
    let velocity = inwards(&arm);
    arm.twist(&twist_of(velocity), 10 * STEP_NS).unwrap();
    assert_eq!(arm.forget(), 1);
    assert_eq!(arm.tick(0).done, None);
    let done = arm.tick(STEP_NS).done.unwrap();
    assert_eq!(done.action.translation.norm(), 0.0);
    assert_eq!(arm.frames(5 * STEP_NS).len(), 1);
}

#[test]
fn a_second_camera_sees_the_same_table_and_fails_on_its_own() {
    let mut settings = Settings {
        has_front_camera: true,
        ..settings(GoalKind::Push, 5)
    };
    let views = |tick: &Tick| {
        tick.frames
            .iter()
            .map(|frame| frame.view)
            .collect::<Vec<_>>()
    };
    let mut both = SimArmStep::new(settings.clone()).unwrap();
    let first = both.tick(0);
    assert_eq!(views(&first), [View::Side, View::Front]);
    // The second camera does not change the first one.
    assert!(arm(GoalKind::Push, 5).tick(0).frames[0] == first.frames[0]);
    assert!(first.frames[0].picture != first.frames[1].picture);
    let velocity = inwards(&both);
    both.twist(&twist_of(velocity), 0).unwrap();
    assert!(both.tick(STEP_NS).frames[1].picture != first.frames[1].picture);
    assert_eq!(both.eyes().count(), 2);

    settings.camera = CameraSettings {
        latency: Duration::from_millis(100),
        drop: 0.5,
        ..CameraSettings::default()
    };
    let mut faulty = SimArmStep::new(settings).unwrap();
    let lost: Vec<_> = (0..40)
        .map(|count| faulty.tick(count * STEP_NS).lost_pictures)
        .collect();
    assert!(lost.contains(&1), "{lost:?}");
    let on_their_way = 2 - lost[39] as usize;
    assert_eq!(faulty.forget(), on_their_way);
}
