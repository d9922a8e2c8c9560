//! The simulated arm over real DDS on loopback: a controller that knows the goal drives it there with twists, and the
//! executor moves it as a chunk says.

use crate::running::{node, refusal, with_nodes};
use wm_msgs::{
    builtin_interfaces::Duration as RosDuration,
    geometry_msgs::{PoseArray, PoseStamped, Twist, TwistStamped, Vector3},
    rosgraph_msgs::Clock,
    sensor_msgs::{CameraInfo, CompressedImage, Image, JointState},
    std_msgs::{Bool, Float64, Header, String as Text},
    std_srvs::{SetBool, SetBoolRequest},
    tf2_msgs::TFMessage,
    vision_msgs::LabelInfo,
    wm_msgs::{Action, ActionChunk, ExecutorStatus, Reset, ResetRequest},
};
use wm_robot_nodes::{executor, sim_arm};
use wm_ros::{Client, Context, Publisher, Qos, Subscription};
use wm_sim::{GoalKind, Target, Variety};

const SEED: u64 = 3;

#[tokio::test(flavor = "current_thread")]
async fn twists_reach_the_goal_and_a_reset_restores_the_start() {
    let parameters = format!("-p task:=reach -p seed:={SEED} -p image_transport:=both");
    with_nodes(&[(&sim_arm::NODE, &parameters)], reach_and_reset).await;
}

async fn reach_and_reset(here: &Context) {
    let table = wm_sim::Environment::new(GoalKind::Reach, SEED, &Variety::default()).unwrap();
    let Target::Tool { position } = table.goal().target else {
        panic!("a reach is of the tool");
    };
    let node = node(here, "controller", "");
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
        let arm = format!("-p seed:={SEED} -p image_transport:=raw");
        let executor =
            format!("-p command_type:={command} -p base_frame:=base_link -p begin:=reception");
        let nodes: [(_, &str); 2] = [(&sim_arm::NODE, &arm), (&executor::NODE, &executor)];
        let moved = with_nodes(&nodes, async |here| executed(here, command).await).await;
        // 0.06 m, but for ticks that are late on a busy machine.
        assert!((0.01..0.09).contains(&moved), "{command}: {moved}");
    }
}

/// How far a chunk of three motions of 0.02 m moves the tool \[m\].
async fn executed(here: &Context, command: &str) -> f64 {
    let node = node(here, "policy", "");
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

/// The messages for persons and other nodes: cameras, poses of the arm and the objects, and the URDF.
#[tokio::test(flavor = "current_thread")]
async fn arm_publishes_cameras_poses_and_objects() {
    let parameters = format!(
        "-p task:=push -p seed:={SEED} -p front_camera:=true -p image_transport:=raw -p real_time_factor:=4.0"
    );
    with_nodes(&[(&sim_arm::NODE, &parameters)], observe).await;
}

async fn observe(here: &Context) {
    let table = wm_sim::Environment::new(GoalKind::Push, SEED, &Variety::default()).unwrap();
    let node = node(here, "observer", "");
    let (latched, depth) = (Qos::latched(1), Qos::reliable(100));
    let mut infos: Subscription<CameraInfo> =
        node.subscription("/camera/camera_info", depth).unwrap();
    let mut images: Subscription<Image> = node.subscription("/camera/image_raw", depth).unwrap();
    let mut front_infos: Subscription<CameraInfo> = node
        .subscription("/front_camera/camera_info", depth)
        .unwrap();
    let mut front: Subscription<Image> =
        node.subscription("/front_camera/image_raw", depth).unwrap();
    let mut frames: Subscription<TFMessage> = node.subscription("/tf", depth).unwrap();
    let mut statics: Subscription<TFMessage> = node.subscription("/tf_static", latched).unwrap();
    let mut poses: Subscription<PoseStamped> = node.subscription("ee_pose", depth).unwrap();
    let mut arms: Subscription<Text> = node.subscription("robot_description", latched).unwrap();
    let mut objects: Subscription<PoseArray> = node.subscription("sim_arm/objects", depth).unwrap();
    let mut names: Subscription<LabelInfo> =
        node.subscription("sim_arm/object_names", latched).unwrap();
    let mut clock: Subscription<Clock> = node.subscription("/clock", depth).unwrap();

    let info = infos.recv().await.unwrap().message;
    while images.recv().await.unwrap().message.header != info.header {}
    assert_eq!(info.header.frame_id, "camera_optical_frame");
    assert_eq!((info.width, info.height, info.d), (256, 256, vec![0.0; 5]));
    let front_info = front_infos.recv().await.unwrap().message;
    assert_eq!(front_info.header.frame_id, "front_camera_optical_frame");
    while front.recv().await.unwrap().message.header != front_info.header {}

    let cameras = statics.recv().await.unwrap().message.transforms;
    let children: Vec<_> = cameras
        .iter()
        .map(|camera| &*camera.child_frame_id)
        .collect();
    assert_eq!(
        children,
        ["camera_optical_frame", "front_camera_optical_frame"]
    );
    // By the transform and the matrix an object is where the simulator's own camera has it: half a pixel off, since ROS
    // counts from the middle of the first pixel.
    let there = objects.recv().await.unwrap().message;
    assert_eq!(there.header.frame_id, "base_link");
    let place = there.poses[0].position;
    let place = nalgebra::Point3::new(place.x, place.y, place.z);
    let transform = cameras[0].transform;
    let (at, turn) = (transform.translation, transform.rotation);
    let optical = nalgebra::Isometry3::from_parts(
        nalgebra::Translation3::new(at.x, at.y, at.z),
        nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(
            turn.w, turn.x, turn.y, turn.z,
        )),
    )
    .inverse_transform_point(&place);
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    let seen = [
        fx * optical.x / optical.z + cx,
        fy * optical.y / optical.z + cy,
    ];
    let expected = table.camera().pixel(&place).unwrap();
    for (seen, expected) in seen.into_iter().zip(expected) {
        assert!(
            (seen + 0.5 - f64::from(expected)).abs() < 1e-3,
            "{seen} {expected}"
        );
    }
    let named = names.recv().await.unwrap().message.class_map;
    let named: Vec<_> = named.into_iter().map(|class| class.class_name).collect();
    let all: Vec<_> = table
        .world()
        .objects()
        .iter()
        .map(|object| object.name())
        .collect();
    assert_eq!((named, there.poses.len()), (all.clone(), all.len()));

    let tool = frames.recv().await.unwrap().message.transforms[0].clone();
    assert_eq!(
        (&*tool.header.frame_id, &*tool.child_frame_id),
        ("base_link", "tool")
    );
    let pose = loop {
        let pose = poses.recv().await.unwrap().message;
        if pose.header.stamp == tool.header.stamp {
            break pose.pose;
        }
    };
    assert_eq!(pose.orientation, tool.transform.rotation);
    assert_eq!(pose.position.x, tool.transform.translation.x);
    let arm = arms.recv().await.unwrap().message.data;
    assert!(arm.contains("<joint name=\"wrist_rotate\""), "{arm}");

    // It makes the time, and tells it more often than it shows pictures.
    let first = clock.recv().await.unwrap().message.clock.to_nanos();
    let mut before = first;
    while before < first + 400_000_000 {
        let now = clock.recv().await.unwrap().message.clock.to_nanos();
        assert!(
            now > before && now <= before + 20_000_000,
            "{}",
            now - before
        );
        before = now;
    }
}

/// A policy that answers each picture with an action is waited for, and the steps are those of a simulator that is
/// called, however long it takes.
#[tokio::test(flavor = "current_thread")]
async fn steps_per_command_equal_those_of_the_environment() {
    let parameters = format!(
        "-p task:=reach -p seed:={SEED} -p image_transport:=raw -p real_time_factor:=0.0 -p noise:=0.0 -p \
         command_timeout:=60.0"
    );
    with_nodes(&[(&sim_arm::NODE, &parameters)], drive_step_by_step).await;
}

async fn drive_step_by_step(here: &Context) {
    let mut table = wm_sim::Environment::new(GoalKind::Reach, SEED, &Variety::default()).unwrap();
    let node = node(here, "policy", "");
    let mut images: Subscription<Image> = node
        .subscription("/camera/image_raw", Qos::reliable(10))
        .unwrap();
    let mut clock: Subscription<Clock> = node.subscription("/clock", Qos::reliable(10)).unwrap();
    let motions: Publisher<Action> = node.publisher("command/action", Qos::reliable(10)).unwrap();
    motions.wait_for_subscribers(1).await;
    images.wait_for_publishers(1).await;
    clock.wait_for_publishers(1).await;
    // The first picture may have gone out before anyone listened; a motion of nothing asks for the next one.
    let still = wm_sim::EndEffectorAction::still(table.world().opening());
    let mut next = still;
    let mut stamp_ns = None;
    for count in 0..6 {
        motions
            .publish(&Action {
                header: Header::default(),
                values: next.values().to_vec(),
            })
            .unwrap();
        table.step(&next).unwrap();
        let image = loop {
            let image = images.recv().await.unwrap().message;
            let is_next = stamp_ns.is_none_or(|before| image.header.stamp.to_nanos() > before);
            if is_next && image.data == *table.picture().as_raw() {
                break image;
            }
        };
        let now_ns = image.header.stamp.to_nanos();
        // The first two may have been done in one step, before anyone waited for an answer.
        if let Some(before) = stamp_ns.replace(now_ns).filter(|_| count > 1) {
            assert_eq!(now_ns, before + 200_000_000);
        }
        while clock.recv().await.unwrap().message.clock.to_nanos() < now_ns {}
        next = table.oracle();
    }
}

#[test]
fn made_time_excludes_use_sim_time() {
    let parameters = "-p use_sim_time:=true -p real_time_factor:=0.0";
    let error = refusal(&sim_arm::NODE, parameters);
    assert!(error.contains("use_sim_time"), "{error}");
}

/// By the arm's own clock, the executor does exactly what a chunk says, however fast time goes.
#[tokio::test(flavor = "current_thread")]
async fn the_executor_keeps_to_the_time_that_the_arm_makes() {
    let arm = format!(
        "-p seed:={SEED} -p image_transport:=raw -p real_time_factor:=0.0 -p command_timeout:=1.0"
    );
    let executor = "-p use_sim_time:=true -p command_clock:=ros -p rate:=5.0 -p stop_within:=0.4 -p \
                 base_frame:=base_link -p begin:=reception -p arm_on_start:=true";
    let nodes: [(_, &str); 2] = [(&sim_arm::NODE, &arm), (&executor::NODE, executor)];
    with_nodes(&nodes, drive_by_made_time).await;
}

async fn drive_by_made_time(here: &Context) {
    let node = node(here, "policy", "--ros-args -p use_sim_time:=true");
    let chunks: Publisher<ActionChunk> = node.publisher("action_chunk", Qos::reliable(10)).unwrap();
    let mut actions: Subscription<Action> =
        node.subscription("action", Qos::reliable(100)).unwrap();
    let mut poses: Subscription<PoseStamped> =
        node.subscription("ee_pose", Qos::reliable(100)).unwrap();
    let mut status: Subscription<ExecutorStatus> = node
        .subscription("executor/status", Qos::latched(1))
        .unwrap();
    chunks.wait_for_subscribers(1).await;
    actions.wait_for_publishers(1).await;
    // The executor has heard what time it is.
    while status.recv().await.unwrap().message.header.stamp.to_nanos() == 0 {}
    while node.count_subscribers("command/twist").unwrap() < 1
        || node.count_publishers("command/twist").unwrap() < 1
    {
        poses.recv().await.unwrap();
    }
    let start = poses.recv().await.unwrap().message;
    let [least, most] = wm_sim::WORKSPACE_M;
    let sign = ((least[1] + most[1]) / 2.0 - start.pose.position.y).signum();
    let action = Action {
        header: start.header.clone(),
        values: vec![0.0, (0.01 * sign) as f32, 0.0, 0.0, 0.0, 0.0, 1.0],
    };
    let period = RosDuration::from_nanos(200_000_000);
    chunks
        .publish(&ActionChunk {
            header: start.header,
            period,
            actions: vec![action; 8],
            ..ActionChunk::default()
        })
        .unwrap();
    let mut moved = 0;
    loop {
        let step = f64::from(actions.recv().await.unwrap().message.values[1]) * sign;
        // A command holds for its step, whole.
        let is_whole = (step - 0.01).abs() < 1e-6;
        assert!(is_whole || step.abs() < 1e-6, "{step} after {moved} steps");
        moved += i32::from(is_whole);
        if moved > 0 && !is_whole {
            break;
        }
    }
    // Of the first ones, time may have been over when they came; and on a busy machine a step may go on by the last
    // command.
    assert!((3..=12).contains(&moved), "{moved}");
}
