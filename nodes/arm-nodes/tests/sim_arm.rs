//! The simulated arm over real DDS on loopback: a controller that knows the goal drives it there with twists, and the
//! executor moves it as a chunk says.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

use std::{thread::JoinHandle, time::Duration};

use wm_arm_nodes::{executor, sim_arm};
use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    geometry_msgs::{PoseStamped, Twist, TwistStamped, Vector3},
    sensor_msgs::{CompressedImage, Image, JointState},
    std_msgs::{Bool, Float64, Header, String as Text},
    std_srvs::{SetBool, SetBoolRequest},
    wm_msgs::{Action, ActionChunk, Reset, ResetRequest},
};
use wm_ros::{Client, Context, Environment, Node, NodeArgs, Publisher, Qos, Reach, Subscription};
use wm_sim::{GoalKind, Target, Variety};

/// Far above anything that happens here; it only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(120);
const SEED: u64 = 3;

/// A domain for each test, so that tests neither meet each other nor another run of them.
fn context(test: u16) -> Context {
    let reach = Reach::Localhost;
    let domain_id = 20 + (std::process::id() % 16) as u16 * 5 + test;
    Context::new(&Environment { domain_id, reach }).unwrap()
}

/// A node at work.
fn start(
    context: &Context,
    name: &'static str,
    words: String,
    body: impl AsyncFnOnce(Node) -> anyhow::Result<()> + Send + 'static,
) -> JoinHandle<anyhow::Result<()>> {
    let context = context.clone();
    std::thread::spawn(move || {
        let args = NodeArgs::parse(words.split_whitespace()).unwrap();
        let node = Node::new(&context, name, wm_ros::NAMESPACE, &args)?;
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?
            .block_on(body(node))
    })
}

#[tokio::test(flavor = "current_thread")]
async fn twists_bring_the_tool_to_the_goal_and_a_reset_back_to_the_start() {
    let running = context(0);
    let words = format!("--ros-args -p task:=reach -p seed:={SEED} -p image_transport:=both");
    let thread = start(&running, "sim_arm", words, sim_arm::body);
    let here = context(0);
    tokio::time::timeout(PATIENCE, scenario(&here))
        .await
        .expect("a message that should come does not");
    running.shutdown().trigger();
    thread.join().unwrap().unwrap();
    running.close();
    here.close();
}

async fn scenario(here: &Context) {
    let table = wm_sim::Environment::new(GoalKind::Reach, SEED, &Variety::default()).unwrap();
    let Target::Tool { position } = table.goal().target else {
        panic!("a reach is of the tool");
    };
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    let node = Node::new(here, "controller", wm_ros::NAMESPACE, &args).unwrap();
    let twists: Publisher<TwistStamped> =
        node.publisher("command/twist", Qos::reliable(1)).unwrap();
    let gripper: Publisher<Float64> = node.publisher("command/gripper", Qos::reliable(1)).unwrap();
    let (latched, depth) = (Qos::latched(1), Qos::reliable(10));
    let mut poses: Subscription<PoseStamped> = node.subscription("ee_pose", depth).unwrap();
    let mut actions: Subscription<Action> = node.subscription("action", depth).unwrap();
    let mut joints: Subscription<JointState> = node.subscription("joint_states", depth).unwrap();
    let mut distances: Subscription<Float64> =
        node.subscription("sim_arm/distance", depth).unwrap();
    let mut successes: Subscription<Bool> = node.subscription("/task/success", latched).unwrap();
    let mut words: Subscription<Text> = node.subscription("/task/instruction", latched).unwrap();
    let mut goals: Subscription<Image> = node.subscription("goal/image", latched).unwrap();
    // As the encoder takes them.
    let raw = Qos::sensor_data();
    let mut jpegs: Subscription<CompressedImage> = node
        .subscription("/camera/image_raw/compressed", raw)
        .unwrap();
    let reset: Client<Reset> = node.client("sim_arm/reset").unwrap();
    twists.wait_for_subscribers(1).await;
    gripper.wait_for_subscribers(1).await;
    actions.wait_for_publishers(1).await;
    reset.wait_for_service().await;

    assert!(!successes.recv().await.unwrap().message.data);
    let instruction = words.recv().await.unwrap().message.data;
    assert_eq!(instruction, table.instruction());
    let goal = goals.recv().await.unwrap().message;
    assert_eq!(
        (goal.width, goal.height, &*goal.encoding),
        (256, 256, "rgb8")
    );
    assert_eq!(goal.data, *table.goal().picture.as_raw());
    let jpeg = jpegs.recv().await.unwrap().message;
    assert_eq!(jpeg.header.frame_id, "camera_optical_frame");

    gripper.publish(&Float64 { data: 0.5 }).unwrap();
    let mut moved = 0.0;
    loop {
        tokio::select! {
            pose = poses.recv() => {
                let pose = pose.unwrap().message;
                assert_eq!(pose.header.frame_id, "base_link");
                let at = pose.pose.position;
                let speed = |missing: f64| (2.0 * missing).clamp(-0.2, 0.2);
                let linear = Vector3 {
                    x: speed(position.x - at.x),
                    y: speed(position.y - at.y),
                    z: speed(position.z - at.z),
                };
                let twist = TwistStamped {
                    header: pose.header,
                    twist: Twist { linear, angular: Vector3::default() },
                };
                twists.publish(&twist).unwrap();
            }
            action = actions.recv() => {
                let values = action.unwrap().message.values;
                assert_eq!(values.len(), 7);
                moved += values.iter().take(3).map(|v| v.abs()).sum::<f32>();
            }
            success = successes.recv() => if success.unwrap().message.data { break },
        }
    }
    assert!(moved > 0.02, "{moved}");
    while distances.recv().await.unwrap().message.data > wm_sim::REACH_TOLERANCE_M {}
    assert_eq!(joints.recv().await.unwrap().message.name.len(), 8);
    // Nobody says anything any more.
    loop {
        let action = actions.recv().await.unwrap().message.values;
        if action[..6].iter().all(|value| *value == 0.0) {
            assert_eq!(action[6], 0.5);
            break;
        }
    }

    let request = ResetRequest {
        seed: 99,
        keep_seed: true,
    };
    let response = reset.call(&request).await.unwrap();
    assert!(response.success && response.message == instruction);
    assert!(!successes.recv().await.unwrap().message.data);
    let request = ResetRequest {
        seed: SEED + 1,
        keep_seed: false,
    };
    assert!(reset.call(&request).await.unwrap().success);
    loop {
        let goal = goals.recv().await.unwrap().message;
        if goal.data != *table.goal().picture.as_raw() {
            break;
        }
    }
}

#[tokio::test(flavor = "current_thread")]
async fn what_the_executor_sends_moves_it_without_remapping() {
    for command in ["twist", "velocity", "action"] {
        let (arm_side, executor_side, here) = (context(1), context(1), context(1));
        let words = format!("--ros-args -p seed:={SEED} -p image_transport:=raw");
        let arm = start(&arm_side, "sim_arm", words, sim_arm::body);
        let words = format!(
            "--ros-args -p command_type:={command} -p base_frame:=base_link -p begin:=reception"
        );
        let executor = start(&executor_side, "executor", words, executor::body);
        let moved = tokio::time::timeout(PATIENCE, executed(&here, command))
            .await
            .unwrap_or_else(|_| panic!("{command}: a message that should come does not"));
        // 0.06 m, but for ticks that are late on a busy machine.
        assert!((0.01..0.09).contains(&moved), "{command}: {moved}");
        for (context, thread) in [(arm_side, arm), (executor_side, executor)] {
            context.shutdown().trigger();
            thread.join().unwrap().unwrap();
            context.close();
        }
        here.close();
    }
}

/// How far a chunk of three motions of 0.02 m moves the tool \[m\].
async fn executed(here: &Context, command: &str) -> f64 {
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    let node = Node::new(here, "policy", wm_ros::NAMESPACE, &args).unwrap();
    let chunks: Publisher<ActionChunk> = node.publisher("action_chunk", Qos::reliable(10)).unwrap();
    let mut poses: Subscription<PoseStamped> =
        node.subscription("ee_pose", Qos::reliable(100)).unwrap();
    let arm: Client<SetBool> = node.client("executor/arm").unwrap();
    chunks.wait_for_subscribers(1).await;
    arm.wait_for_service().await;
    // The executor and the arm have to know of each other, too.
    while node
        .count_subscribers(&format!("command/{command}"))
        .unwrap()
        < 1
        || node
            .count_publishers(&format!("command/{command}"))
            .unwrap()
            < 1
    {
        poses.recv().await.unwrap();
    }
    let armed = arm.call(&SetBoolRequest { data: true }).await.unwrap();
    assert!(armed.success, "{}", armed.message);
    let start = poses.recv().await.unwrap().message.pose.position;
    // Towards the middle of the workspace, where nothing limits it.
    let [least, most] = wm_sim::WORKSPACE_M;
    let sign = ((least[1] + most[1]) / 2.0 - start.y).signum();
    let header = Header {
        stamp: node.now(),
        frame_id: "base_link".into(),
    };
    let action = Action {
        header: header.clone(),
        values: vec![0.0, (0.02 * sign) as f32, 0.0, 0.0, 0.0, 0.0, 1.0],
    };
    let period = RosDuration::from_nanos(200_000_000);
    let chunk = ActionChunk {
        header,
        period,
        actions: vec![action; 3],
        ..ActionChunk::default()
    };
    chunks.publish(&chunk).unwrap();
    let moved = |pose: PoseStamped| (pose.pose.position.y - start.y) * sign;
    let mut before = 0.0;
    loop {
        let now = moved(poses.recv().await.unwrap().message);
        if now > 0.0 && now == before {
            return now;
        }
        before = now;
    }
}
