//! The executor over real DDS on loopback, in a participant of its own: chunks and calls in, commands out. Nothing here
//! sleeps: every step waits for the message that it causes.

use crate::fresh_domain::fresh_domain;
use std::time::Duration;

use crate::running::{context, in_time, node, refusal, start, with_nodes};
use wm_msgs::{
    Message,
    builtin_interfaces::{Duration as RosDuration, Time},
    geometry_msgs::{PoseStamped, TwistStamped},
    std_msgs::{Bool, Float64, Float64MultiArray, Header},
    std_srvs::{Outcome, SetBool, SetBoolRequest, Trigger, TriggerRequest},
    wm_msgs::{Action, ActionChunk, ExecutorStatus, Plan},
};
use wm_robot_nodes::executor;
use wm_ros::{Client, Context, Node, Publisher, Qos, Subscription};

/// The policy, the person and the arm.
struct World {
    node: Node,
    chunks: Publisher<ActionChunk>,
    emergency: Publisher<Bool>,
    status: Subscription<ExecutorStatus>,
    arm: Client<SetBool>,
    reset: Client<Trigger>,
}

impl World {
    async fn new(context: &Context) -> Self {
        let node = node(context, "world", "");
        let world = Self {
            chunks: node.publisher("action_chunk", Qos::reliable(10)).unwrap(),
            emergency: node.publisher("emergency_stop", Qos::latched(1)).unwrap(),
            status: node
                .subscription("executor/status", Qos::latched(1))
                .unwrap(),
            arm: node.client("executor/arm").unwrap(),
            reset: node.client("executor/reset").unwrap(),
            node,
        };
        world.chunks.wait_for_subscribers(1).await;
        world.emergency.wait_for_subscribers(1).await;
        world.status.wait_for_publishers(1).await;
        world.arm.wait_for_service().await;
        world.reset.wait_for_service().await;
        world
    }

    /// A chunk that begins now: 0.1 m/s forward for a while.
    fn go(&self, frame_id: &str) {
        let mut chunk = ActionChunk {
            period: RosDuration::from_nanos(200_000_000),
            ..ActionChunk::default()
        };
        chunk.header.stamp = self.node.now();
        chunk.header.frame_id = frame_id.into();
        let action = Action {
            header: chunk.header.clone(),
            values: vec![0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        };
        chunk.actions = vec![action; 3];
        self.chunks.publish(&chunk).unwrap();
    }

    async fn set_armed(&self, data: bool) -> Outcome {
        self.arm.call(&SetBoolRequest { data }).await.unwrap()
    }

    /// Subscribes to a topic of the executor, and waits for its publisher.
    async fn subscribe<M: Message>(&self, topic: &str) -> Subscription<M> {
        let subscription = self.node.subscription(topic, Qos::reliable(100)).unwrap();
        subscription.wait_for_publishers(1).await;
        subscription
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
}

#[tokio::test(flavor = "current_thread")]
async fn armed_executor_turns_chunks_into_twists_then_zero() {
    let parameters = "-p base_frame:=base_link";
    let scenario = async |here: &Context| {
        let mut world = World::new(here).await;
        let mut twists = world.subscribe::<TwistStamped>("command/twist").await;
        let mut previews = world
            .subscribe::<TwistStamped>("executor/command_preview")
            .await;
        let mut gripper = world.subscribe::<Float64>("command/gripper").await;

        world.go("base_link");
        while previews.recv().await.unwrap().message.twist.linear.x < 0.09 {}
        assert!(twists.try_recv().is_none(), "it is not armed");
        world.go("camera");
        let status = world.status(|status| status.refused > 0).await;
        assert!(status.reason.contains("\"camera\""), "{}", status.reason);

        assert!(world.set_armed(true).await.success);
        world.go("base_link");
        let first = twists.recv().await.unwrap().message;
        assert_eq!(first.header.frame_id, "base_link");
        let mut before = first.twist.linear.x;
        while before < 0.09 {
            before = twists.recv().await.unwrap().message.twist.linear.x;
            assert!(before < 0.11, "{before}");
        }
        assert_eq!(gripper.recv().await.unwrap().message.data, 1.0);
        let executing = |status: &ExecutorStatus| status.state == ExecutorStatus::EXECUTING;
        let status = world.status(executing).await;
        assert_ne!(status.chunk_stamp, Time::default());
        // No further chunk comes.
        loop {
            let forward = twists.recv().await.unwrap().message.twist.linear.x;
            assert!((0.0..0.11).contains(&forward), "{forward}");
            if forward == 0.0 {
                break;
            }
        }
        let idle = |status: &ExecutorStatus| status.state == ExecutorStatus::IDLE;
        let status = world.status(idle).await;
        assert!(status.reason.contains("none followed"), "{}", status.reason);
    };
    with_nodes(&[(&executor::NODE, parameters)], scenario).await;
}

/// As where std_srvs is not at hand, and the arm is a simulated one.
#[tokio::test(flavor = "current_thread")]
async fn armed_from_the_start_it_executes_without_a_call() {
    let parameters = "-p arm_on_start:=true";
    let scenario = async |here: &Context| {
        let mut world = World::new(here).await;
        let mut twists = world.subscribe::<TwistStamped>("command/twist").await;
        let idle = |status: &ExecutorStatus| status.state == ExecutorStatus::IDLE;
        world.status(idle).await;
        world.go("base_link");
        while twists.recv().await.unwrap().message.twist.linear.x < 0.09 {}
        // Stopped, it is no more armed than otherwise.
        world.emergency.publish(&Bool { data: true }).unwrap();
        world
            .status(|status| status.state == ExecutorStatus::STOPPED)
            .await;
        world.emergency.publish(&Bool { data: false }).unwrap();
        while !world
            .reset
            .call(&TriggerRequest::default())
            .await
            .unwrap()
            .success
        {}
        world
            .status(|status| status.state == ExecutorStatus::DRY_RUN)
            .await;
    };
    with_nodes(&[(&executor::NODE, parameters)], scenario).await;
}

#[tokio::test(flavor = "current_thread")]
async fn an_emergency_stop_ends_a_motion_and_latches() {
    let parameters = "-p command_type:=velocity -p publish_action:=true";
    let scenario = async |here: &Context| {
        let mut world = World::new(here).await;
        let mut velocities = world
            .subscribe::<Float64MultiArray>("command/velocity")
            .await;
        let mut actions = world.subscribe::<Action>("action").await;
        assert!(world.set_armed(true).await.success);
        world.go("base_link");
        while velocities.recv().await.unwrap().message.data[0] < 0.09 {}
        // 0.1 m/s for 50 ms, unless it still accelerates.
        let action = actions.recv().await.unwrap().message;
        assert!((0.0..0.006).contains(&action.values[0]), "{action:?}");

        world.emergency.publish(&Bool { data: true }).unwrap();
        let stopped = |status: &ExecutorStatus| status.state == ExecutorStatus::STOPPED;
        let status = world.status(stopped).await;
        assert!(
            status.reason.contains("emergency_stop"),
            "{}",
            status.reason
        );
        loop {
            let velocity = velocities.recv().await.unwrap().message;
            assert_eq!((velocity.data.len(), velocity.layout.dim[0].size), (6, 6));
            if velocity.data == [0.0; 6] {
                break;
            }
        }
        assert!(!world.set_armed(true).await.success);
        let reset = world.reset.call(&TriggerRequest::default()).await.unwrap();
        assert!(!reset.success, "{}", reset.message);
        world.emergency.publish(&Bool { data: false }).unwrap();
        loop {
            let reset = world.reset.call(&TriggerRequest::default()).await.unwrap();
            if reset.success {
                break;
            }
        }
        assert!(world.set_armed(true).await.success);
    };
    with_nodes(&[(&executor::NODE, parameters)], scenario).await;
}

#[tokio::test(flavor = "current_thread")]
async fn a_node_that_ends_stops_the_arm_first() {
    let domain = fresh_domain();
    let running = context(domain);
    let thread = start(&running, &executor::NODE, "-p command_type:=action");
    let here = context(domain);
    let mut motions = in_time(async {
        let world = World::new(&here).await;
        let mut motions = world.subscribe::<Action>("command/action").await;
        assert!(world.set_armed(true).await.success);
        world.go("base_link");
        while motions.recv().await.unwrap().message.values[0] < 0.0045 {}
        motions
    })
    .await;
    running.shutdown().trigger();
    in_time(async { while motions.recv().await.unwrap().message.values[0] != 0.0 {} }).await;
    thread.join().unwrap().unwrap();
    running.close();
    here.close();
}

#[tokio::test(flavor = "current_thread")]
async fn it_moves_while_the_deadman_is_held_and_the_pose_is_known() {
    let parameters = "-p base_frame:=base_link -p require_deadman:=true -p source:=plan -p workspace_min:=[-1.0,-1.0,-1.0] \
         -p workspace_max:=[1.0,1.0,1.0]";
    let scenario = async |here: &Context| {
        let node = node(here, "world", "");
        let plans: Publisher<Plan> = node.publisher("plan", Qos::reliable(10)).unwrap();
        let deadman: Publisher<Bool> = node.publisher("deadman", Qos::reliable(10)).unwrap();
        let poses: Publisher<PoseStamped> = node.publisher("ee_pose", Qos::reliable(10)).unwrap();
        let arm: Client<SetBool> = node.client("executor/arm").unwrap();
        let mut status: Subscription<ExecutorStatus> = node
            .subscription("executor/status", Qos::latched(1))
            .unwrap();
        let mut twists: Subscription<TwistStamped> = node
            .subscription("command/twist", Qos::reliable(100))
            .unwrap();
        plans.wait_for_subscribers(1).await;
        deadman.wait_for_subscribers(1).await;
        poses.wait_for_subscribers(1).await;
        twists.wait_for_publishers(1).await;
        arm.wait_for_service().await;
        let armed = arm.call(&SetBoolRequest { data: true }).await.unwrap();
        assert!(armed.success, "{}", armed.message);

        let mut pose = PoseStamped::default();
        pose.header.frame_id = "base_link".into();
        let mut plan = Plan {
            period: RosDuration::from_nanos(400_000_000),
            ..Plan::default()
        };
        let mut ticks = tokio::time::interval(Duration::from_millis(20));
        loop {
            tokio::select! {
                _ = ticks.tick() => {
                    deadman.publish(&Bool { data: true }).unwrap();
                    poses.publish(&pose).unwrap();
                    plan.header.stamp = node.now();
                    pose.header.stamp = node.now();
                    let header = Header { frame_id: "base_link".into(), ..plan.header.clone() };
                    let values = vec![0.0, 0.04, 0.0, 0.0, 0.0, 0.0, 0.0];
                    plan.actions = vec![Action { header, values }; 20];
                    plans.publish(&plan).unwrap();
                }
                twist = twists.recv() => if twist.unwrap().message.twist.linear.y > 0.09 { break },
            }
        }
        // Plans of eight seconds are under way, but nobody holds the switch.
        while twists.recv().await.unwrap().message.twist.linear.y != 0.0 {}
        loop {
            let status = status.recv().await.unwrap().message;
            if status.reason.contains("_timeout") {
                break;
            }
        }
    };
    with_nodes(&[(&executor::NODE, parameters)], scenario).await;
}

#[test]
fn parameters_that_contradict_each_other_are_named() {
    for (parameters, named) in [
        ("-p max_linear_acceleration:=0.5", "stop_within"),
        (
            "-p workspace_min:=[0.0,0.0,0.0] -p workspace_max:=[1.0,1.0,1.0]",
            "base_frame",
        ),
        (
            "-p base_frame:=base -p workspace_min:=[0.0,0.0]",
            "workspace_min has 2 numbers",
        ),
        ("-p action_space:=/nowhere.json", "/nowhere.json"),
        (
            "-p arm_on_start:=true -p require_emergency_stop:=true",
            "expected one of them",
        ),
    ] {
        let error = refusal(&executor::NODE, parameters);
        assert!(error.contains(named), "{error}");
    }
}
