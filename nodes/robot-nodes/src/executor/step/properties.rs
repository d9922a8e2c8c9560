//! Properties that hold for any input.

use proptest::prelude::*;

use super::{tests::*, *};
use crate::executor::{
    Deadman, State, Velocity, Workspace,
    rates::{norm, plus},
};

/// The limits of the tests' settings.
const LINEAR: (f64, f64) = (0.25, 2.0);
const ANGULAR: (f64, f64) = (1.25, 10.0);

/// An event between two commands.
#[derive(Clone, Debug)]
enum Event {
    Nothing,
    Arm,
    Disarm,
    Stop,
    Reset,
    Deadman(bool),
    /// Stamp relative to now \[ms\], duration of an action \[ms\], and the actions.
    Chunk(i64, i64, Vec<Vec<f32>>),
}

fn value() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -0.1_f32..0.1,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => -1e3_f32..1e3,
    ]
}

fn event() -> impl Strategy<Value = Event> {
    let good = prop::collection::vec(-0.1_f32..0.1, 6).prop_map(|mut values| {
        values.push(1.0);
        values
    });
    let action = prop_oneof![20 => good.boxed(), 1 => prop::collection::vec(value(), 0..9).boxed()];
    let actions = prop::collection::vec(action, 0..6);
    prop_oneof![
        6 => Just(Event::Nothing),
        1 => Just(Event::Arm),
        1 => prop_oneof![Just(Event::Disarm), Just(Event::Stop), Just(Event::Reset)],
        2 => prop::bool::weighted(0.9).prop_map(Event::Deadman),
        6 => (-300_i64..300, 1_i64..400, actions).prop_map(|(stamp, period, actions)| {
            Event::Chunk(stamp, period, actions)
        }),
    ]
}

proptest! {
    #[test]
    fn commands_keep_to_the_limits(
        events in prop::collection::vec((event(), 1_i64..150), 1..120),
        needs_deadman in any::<bool>(),
    ) {
        let deadman = needs_deadman.then(|| Deadman::new(Duration::from_millis(500)));
        let mut bench = Bench::new(Settings { deadman, ..settings() });
        let mut ms = 0;
        let mut before = Rates::zero(6);
        let mut is_sent_before = false;
        let (mut was_armed, mut is_stopped) = (false, false);
        for (event, wait_ms) in events {
            ms += wait_ms;
            match event {
                Event::Nothing => {}
                Event::Arm => was_armed |= bench.step.arm().is_ok(),
                Event::Disarm => bench.step.disarm(Cause::Disarmed),
                Event::Stop => {
                    bench.step.stop("~/stop");
                    is_stopped = true;
                }
                Event::Reset => is_stopped &= bench.step.reset().is_err(),
                Event::Deadman(is_held) => bench.step.deadman(is_held, bench.at(ms).at),
                Event::Chunk(stamp_ms, period_ms, actions) => {
                    let mut message = chunk(ms + stamp_ms, 0.0, actions.len());
                    message.period = wm_msgs::builtin_interfaces::Duration::from_nanos(period_ms * 1_000_000);
                    for (action, values) in message.actions.iter_mut().zip(actions) {
                        action.values = values;
                    }
                    bench.offer(ms, &message).ok();
                }
            }
            let output = bench.tick(ms);
            let (command, is_sent) = match output {
                Output::Silent => (None, false),
                Output::Preview(command) => (Some(command), false),
                Output::Send(command) => (Some(command), true),
            };
            prop_assert!(was_armed || !is_sent, "sent before it was armed");
            if bench.step.status().state == State::DryRun {
                prop_assert!(!is_sent, "sent in a dry run");
            }
            let velocity = command.map_or(Rates::zero(6), |command| command.velocity);
            let numbers = velocity.as_slice().iter().copied();
            prop_assert!(numbers.chain(command.and_then(|command| command.gripper)).all(f64::is_finite));
            prop_assert!(norm(&velocity.velocity().linear) <= LINEAR.0 + 1e-9);
            prop_assert!(norm(&velocity.velocity().angular) <= ANGULAR.0 + 1e-9);
            if is_stopped {
                prop_assert!(velocity.is_zero(), "moves after an emergency stop");
            } else if is_sent || is_sent_before {
                // Nothing that goes out, or ceases to, is a jump.
                let seconds = if is_sent_before { wait_ms as f64 / 1e3 } else { 0.05_f64.max(wait_ms as f64 / 1e3) };
                let start = if is_sent_before { before } else { Rates::zero(6) };
                let change = velocity.plus(start, -1.0).velocity();
                prop_assert!(norm(&change.linear) <= LINEAR.1 * seconds + 1e-9);
                prop_assert!(norm(&change.angular) <= ANGULAR.1 * seconds + 1e-9);
            }
            before = velocity;
            is_sent_before = is_sent;
        }
        // Whatever happened: with nothing more to do, it stands still.
        bench.step.disarm(Cause::Disarmed);
        let mut last = Rates::zero(6);
        for _ in 0..4 {
            ms += 50;
            if let Output::Send(command) = bench.tick(ms) {
                last = command.velocity;
            }
        }
        prop_assert!(last.is_zero(), "{last:?}");
    }

    /// An arm that follows commands at once, and sometimes reports its position.
    #[test]
    fn no_motion_leaves_the_box(
        motions in prop::collection::vec((prop::array::uniform3(-0.1_f32..0.1), 1_i64..10), 1..40),
        silences in prop::collection::vec(1_i64..4, 1..10),
    ) {
        let (least, most) = ([-0.1, -0.15, 0.0], [0.1, 0.05, 0.3]);
        let (lookahead, timeout) = (Duration::from_millis(300), Duration::from_millis(200));
        let workspace = Some(Workspace::new(least, most, lookahead, timeout));
        let mut bench = Bench::new(Settings { workspace, ..settings() });
        bench.step.arm().unwrap();
        let mut position = Rates::of([0.0, 0.0, 0.1]);
        let mut silence = silences.iter().cycle();
        let (mut ms, mut wait) = (0, 0);
        for (motion, ticks) in motions {
            for tick in 0..ticks {
                if wait == 0 {
                    let mut pose = PoseStamped::default();
                    let [x, y, z] = position.velocity().linear;
                    pose.pose.position = wm_msgs::geometry_msgs::Point { x, y, z };
                    bench.step.pose(&pose, bench.at(ms)).unwrap();
                    wait = *silence.next().unwrap();
                }
                wait -= 1;
                if tick == 0 {
                    let mut message = chunk(ms, 0.0, 10);
                    for action in &mut message.actions {
                        action.values[..3].copy_from_slice(&motion);
                    }
                    bench.offer(ms, &message).unwrap();
                }
                if let Output::Send(command) = bench.tick(ms) {
                    position = position.plus(command.velocity, 0.05);
                }
                ms += 50;
                for ((at, least), most) in position.as_slice().iter().zip(least).zip(most) {
                    prop_assert!((least - 1e-9..=most + 1e-9).contains(at), "{at} of {least} to {most}");
                }
            }
        }
    }

    #[test]
    fn a_change_of_velocity_is_bounded(from in prop::array::uniform3(-1.0_f64..1.0), to in prop::array::uniform3(-1.0_f64..1.0)) {
        let limits = settings().limits;
        let of = |linear| limits.within(Velocity { linear, angular: linear }.into());
        let (from, to) = (of(from), of(to));
        let linear = |rates: Rates| rates.velocity().linear;
        let next = limits.toward(from, to, 0.05);
        prop_assert!(norm(plus(&linear(next), &linear(from), -1.0).as_slice()) <= 0.1 + 1e-12);
        prop_assert!(norm(&linear(next)) <= LINEAR.0 + 1e-12);
        // It gets there, and with no axis further off than before.
        let is_between = |((next, from), to): ((&f64, f64), f64)| {
            (from.min(to) - 1e-12..=from.max(to) + 1e-12).contains(next)
        };
        prop_assert!(linear(next).iter().zip(linear(from)).zip(linear(to)).all(is_between));
        let mut velocity = from;
        for _ in 0..10 {
            velocity = limits.toward(velocity, to, 0.05);
        }
        prop_assert_eq!(velocity, to);
    }
}
