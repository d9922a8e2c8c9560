//! The executor over real DDS on loopback, when its clock, the camera or the emergency stop fails. Nothing here sleeps:
//! time passes with the commands that come.

use crate::fresh_domain::fresh_domain;
use std::time::{Duration, Instant};

use crate::running::{PATIENCE, context, node, with_nodes};
use wm_msgs::{
    builtin_interfaces::{Duration as RosDuration, Time},
    geometry_msgs::TwistStamped,
    rosgraph_msgs::Clock,
    std_msgs::{Bool, String as Text},
    std_srvs::{Outcome, SetBool, SetBoolRequest, Trigger, TriggerRequest},
    wm_msgs::{Action, ActionChunk, CameraState, ExecutorStatus},
};
use wm_robot_nodes::executor;
use wm_ros::{Client, Context, Node, Publisher, Qos, Subscription};

/// When simulated clocks begin \[ns\].
const BEGIN_NS: i64 = 1_700_000_000_000_000_000;

/// The executor, and the world around it, while `scenario` runs.
async fn run(parameters: &str, words: &str, scenario: impl AsyncFnOnce(World)) {
    let scenario = async |here: &Context| {
        scenario(World::new(node(here, "world", words)).await).await;
    };
    with_nodes(&[(&executor::NODE, parameters)], scenario).await;
}

/// The policy, the person and the arm.
struct World {
    node: Node,
    chunks: Publisher<ActionChunk>,
    twists: Subscription<TwistStamped>,
    status: Subscription<ExecutorStatus>,
    arm: Client<SetBool>,
    reset: Client<Trigger>,
}

impl World {
    async fn new(node: Node) -> Self {
        let latched = Qos::latched(1);
        let world = Self {
            chunks: node.publisher("action_chunk", Qos::reliable(10)).unwrap(),
            twists: node
                .subscription("command/twist", Qos::reliable(1_000))
                .unwrap(),
            status: node.subscription("executor/status", latched).unwrap(),
            arm: node.client("executor/arm").unwrap(),
            reset: node.client("executor/reset").unwrap(),
            node,
        };
        world.chunks.wait_for_subscribers(1).await;
        world.twists.wait_for_publishers(1).await;
        world.status.wait_for_publishers(1).await;
        world.arm.wait_for_service().await;
        world.reset.wait_for_service().await;
        world
    }

    /// A chunk of 8 s that begins at `stamp`: 0.1 m/s forward.
    fn chunk(stamp: Time) -> ActionChunk {
        let mut chunk = ActionChunk {
            period: RosDuration::from_nanos(400_000_000),
            ..ActionChunk::default()
        };
        chunk.header.stamp = stamp;
        let action = Action {
            header: chunk.header.clone(),
            values: vec![0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        };
        chunk.actions = vec![action; 20];
        chunk
    }

    fn go(&self) {
        self.chunks.publish(&Self::chunk(self.node.now())).unwrap();
    }

    async fn set_armed(&self, data: bool) -> Outcome {
        self.arm.call(&SetBoolRequest { data }).await.unwrap()
    }

    async fn forward(&mut self) -> f64 {
        self.twists.recv().await.unwrap().message.twist.linear.x
    }

    /// Waits until the arm moves, and drops the commands up to then.
    async fn moves(&mut self) {
        while self.forward().await < 0.09 {}
        while self.twists.try_recv().is_some() {}
    }

    /// The distance that is commanded until the arm stands still \[m\], and how long that takes.
    async fn stops(&mut self) -> (f64, Duration) {
        let (begin, mut metres) = (Instant::now(), 0.0);
        loop {
            match self.forward().await {
                0.0 => return (metres, begin.elapsed()),
                forward => metres += forward * 0.05,
            }
        }
    }

    /// Waits for a status.
    async fn status(&mut self, is_it: impl Fn(&ExecutorStatus) -> bool) -> ExecutorStatus {
        loop {
            let status = self.status.recv().await.unwrap().message;
            if is_it(&status) {
                return status;
            }
        }
    }

    async fn reason(&mut self, part: &str) -> ExecutorStatus {
        self.status(|status| status.reason.contains(part)).await
    }
}

/// Publishes the time every 20 ms until a moment.
async fn publish_time(clock: &Publisher<Clock>, until: impl AsyncFnOnce()) {
    let begin = Instant::now();
    let mut ticks = tokio::time::interval(Duration::from_millis(20));
    let mut until = std::pin::pin!(until());
    loop {
        tokio::select! {
            () = &mut until => return,
            _ = ticks.tick() => {
                let passed_ns = i64::try_from(begin.elapsed().as_nanos()).unwrap();
                let clock_ns = BEGIN_NS + passed_ns;
                clock.publish(&Clock { clock: Time::from_nanos(clock_ns) }).unwrap();
            }
        }
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_clock_that_stops_stops_the_arm_within_max_age() {
    for command_clock in ["real", "ros"] {
        let parameters = format!(
            "-p use_sim_time:=true -p command_clock:={command_clock} -p max_age:=4.0 -p arm_on_start:=true"
        );
        let words = "--ros-args -p use_sim_time:=true";
        run(&parameters, words, async |mut world| {
            let clock = world
                .node
                .publisher::<Clock>("/clock", Qos::reliable(10))
                .unwrap();
            // The executor and this node.
            clock.wait_for_subscribers(2).await;
            let mut moving = None;
            publish_time(&clock, async || {
                world
                    .status(|status| status.header.stamp.to_nanos() > BEGIN_NS)
                    .await;
                while world.node.now().to_nanos() < BEGIN_NS {
                    tokio::task::yield_now().await;
                }
                world.go();
                world.moves().await;
                moving = Some(world);
            })
            .await;
            // It stands still now.
            let mut world = moving.unwrap();
            let (metres, taken) = world.stops().await;
            // clock_timeout and stop_within; the executor may be late on a busy machine, but by real time.
            assert!(metres < 0.25, "{metres} m in {taken:?}");
            let status = world.reason("/clock has not advanced").await;
            assert!(status.interrupted > 0);
            // A policy that goes on by the clock that stands still.
            world.go();
            world.status(|status| status.refused > 0).await;
        })
        .await;
    }
}

#[tokio::test(flavor = "current_thread")]
async fn a_max_age_too_short_to_stop_in_is_refused() {
    let here = context(fresh_domain());
    let executor = |words: &str| {
        let node = node(&here, "executor", &format!("--ros-args {words}"));
        tokio::time::timeout(PATIENCE, (executor::NODE.body)(node))
    };
    let refused = executor("-p use_sim_time:=true -p max_age:=0.29").await;
    let text = refused.expect("it starts").unwrap_err().to_string();
    let expected =
        "max_age is 0.29 s and stop_within is 0.2 s: expected max_age to be at least 0.300 s";
    assert!(text.contains(expected), "{text}");
    here.close();
}

#[tokio::test(flavor = "current_thread")]
async fn a_frozen_camera_stops_the_arm_until_newer_frames_come() {
    run(
        "-p arm_on_start:=true -p camera_timeout:=60.0",
        "",
        async |mut world| {
            let cameras: Publisher<CameraState> = world
                .node
                .publisher("camera_state", Qos::reliable(10))
                .unwrap();
            cameras.wait_for_subscribers(1).await;
            let see = |world: &World, frozen: bool| {
                let mut state = CameraState {
                    frozen,
                    ..CameraState::default()
                };
                if frozen {
                    state.reason = "the picture is the same for 2 s".into();
                }
                state.header.stamp = world.node.now();
                cameras.publish(&state).unwrap();
            };
            see(&world, false);
            world.go();
            world.moves().await;
            see(&world, true);
            let (metres, _) = world.stops().await;
            assert!(metres < 0.1, "{metres} m");
            world.reason("the picture is the same for 2 s").await;
            world.go();
            world.status(|status| status.refused > 0).await;
            see(&world, false);
            let mut offers = tokio::time::interval(Duration::from_millis(50));
            loop {
                tokio::select! {
                    _ = offers.tick() => world.chunks.publish(&World::chunk(world.node.now())).unwrap(),
                    twist = world.twists.recv() => if twist.unwrap().message.twist.linear.x > 0.09 { break },
                }
            }
        },
    )
    .await;
}

#[tokio::test(flavor = "current_thread")]
async fn a_best_effort_emergency_stop_stops_the_arm() {
    run("", "", async |mut world| {
        let emergency: Publisher<Bool> = world
            .node
            .publisher("emergency_stop", Qos::best_effort(1))
            .unwrap();
        emergency.wait_for_subscribers(1).await;
        assert!(world.set_armed(true).await.success);
        world.go();
        world.moves().await;
        let mut presses = tokio::time::interval(Duration::from_millis(20));
        let stopped = loop {
            tokio::select! {
                _ = presses.tick() => emergency.publish(&Bool { data: true }).unwrap(),
                status = world.status(|status| status.state == ExecutorStatus::STOPPED) => break status,
            }
        };
        assert!(stopped.reason.contains("emergency_stop"), "{}", stopped.reason);
        while world.forward().await != 0.0 {}
        let refused = world.reset.call(&TriggerRequest::default()).await.unwrap();
        assert!(!refused.success, "{}", refused.message);
        assert!(!world.set_armed(true).await.success);
        loop {
            emergency.publish(&Bool { data: false }).unwrap();
            let reset = world.reset.call(&TriggerRequest::default()).await.unwrap();
            if reset.success {
                break;
            }
        }
        assert!(world.set_armed(true).await.success);
        // The publisher that could stop it goes.
        world.go();
        world.moves().await;
        drop(emergency);
        world.stops().await;
        world.reason("a publisher of emergency_stop is gone").await;
        world
            .status(|status| status.state == ExecutorStatus::DRY_RUN)
            .await;
    })
    .await;
}

#[tokio::test(flavor = "current_thread")]
async fn an_emergency_stop_of_another_type_keeps_the_arm_disarmed() {
    run("", "", async |mut world| {
        let wrong: Publisher<Text> = world
            .node
            .publisher("emergency_stop", Qos::reliable(1))
            .unwrap();
        loop {
            let outcome = world.set_armed(true).await;
            // If it is discovered while the node is armed, it disarms the node.
            if outcome.message.contains("std_msgs/msg/String") {
                assert!(!outcome.success);
                break;
            }
        }
        world
            .status(|status| status.state == ExecutorStatus::DRY_RUN)
            .await;
        drop(wrong);
        while !world.set_armed(true).await.success {}
    })
    .await;
}

#[tokio::test(flavor = "current_thread")]
async fn a_required_emergency_stop_has_to_be_connected() {
    run("-p require_emergency_stop:=true", "", async |mut world| {
        let refused = world.set_armed(true).await;
        assert!(!refused.success);
        assert!(
            refused.message.contains("require_emergency_stop"),
            "{}",
            refused.message
        );
        let emergency: Publisher<Bool> = world
            .node
            .publisher("emergency_stop", Qos::latched(1))
            .unwrap();
        while !world.set_armed(true).await.success {}
        world.go();
        world.moves().await;
        emergency.publish(&Bool { data: true }).unwrap();
        world
            .status(|status| status.state == ExecutorStatus::STOPPED)
            .await;
    })
    .await;
}
