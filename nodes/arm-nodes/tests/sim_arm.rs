//! The simulated arm over real DDS on loopback: a controller that knows the goal drives it there with twists.

#![allow(clippy::unwrap_used, clippy::expect_used)] // the helpers of tests too, not only what is marked #[test]

use std::time::Duration;

use wm_arm_nodes::sim_arm;
use wm_msgs::{
    geometry_msgs::{PoseStamped, Twist, TwistStamped, Vector3},
    sensor_msgs::{CompressedImage, Image, JointState},
    std_msgs::{Bool, Float64, String as Text},
    wm_msgs::{Action, Reset, ResetRequest},
};
use wm_ros::{Client, Context, Environment, Node, NodeArgs, Publisher, Qos, Reach, Subscription};
use wm_sim::{GoalKind, Target, Variety};

/// Far above anything that happens here; it only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(120);
const SEED: u64 = 3;

/// Not one of the other tests', nor of another run of this one.
fn domain() -> u16 {
    20 + (std::process::id() % 16) as u16 * 5
}

fn context() -> Context {
    let reach = Reach::Localhost;
    let domain_id = domain();
    Context::new(&Environment { domain_id, reach }).unwrap()
}

#[tokio::test(flavor = "current_thread")]
async fn twists_bring_the_tool_to_the_goal_and_a_reset_back_to_the_start() {
    let running = context();
    let of_thread = running.clone();
    let thread = std::thread::spawn(move || {
        let words = format!("--ros-args -p task:=reach -p seed:={SEED} -p image_transport:=both");
        let args = NodeArgs::parse(words.split_whitespace()).unwrap();
        let node = Node::new(&of_thread, "sim_arm", wm_ros::NAMESPACE, &args)?;
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?
            .block_on(sim_arm::body(node))
    });
    let here = context();
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
