//! The examples that connect policy servers of others: openpi's published protocol, and a real LeRobot server.

// each test has its own runtime, in which nothing else takes the lock
#![allow(clippy::await_holding_lock)]

use std::{net::TcpListener, path::Path, process::Command, time::Duration};

use wm_msgs::{
    builtin_interfaces::Time,
    diagnostic_msgs::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::{Image, JointState},
    std_msgs::{Float64, String as Text},
    wm_msgs::ActionChunk,
};
use wm_ros::{Context, Node, Publisher, Qos, Subscription};

use crate::harness::{Process, Signal, example, fresh_domain, join, peers, root};

/// Far longer than needed; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(90);
const PERIOD_NS: i64 = 100_000_000;
const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;
/// Bytes at the end of each row of the picture that are no pixels.
const PADDING: u32 = 8;
const INSTRUCTION: &str = "lift the cup";

/// A port that is free now, for a server that does not choose one itself.
fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    listener.local_addr().expect("an address").port()
}

/// A server under `tests/interop`, with the packages of the environment `packages`. It may write to `folder`.
fn server(peers: &Path, packages: &str, script: &str, args: &[&str], folder: &Path) -> Process {
    let mut command = Command::new(peers.join(packages).join("bin/python"));
    command
        .arg(root().join("tests/interop").join(script))
        .args(args)
        // LeRobot's server writes a log there
        .current_dir(folder)
        .env_remove("LD_LIBRARY_PATH");
    Process::start(command)
}

/// A camera and an arm, beside the topics of a policy.
struct Robot {
    node: Node,
    // the node ends with it
    _context: Context,
    camera: Publisher<Image>,
    joints: Publisher<JointState>,
    gripper: Publisher<Float64>,
    instruction: Publisher<Text>,
    chunks: Subscription<ActionChunk>,
    diagnostics: Subscription<DiagnosticArray>,
    /// The next picture, except for its stamp.
    picture: Image,
    /// How far the camera's clock is ahead \[ns\].
    ahead_ns: i64,
    has_joints: bool,
    received: Vec<ActionChunk>,
    /// Name of the policy's node.
    policy: &'static str,
    /// Its newest status.
    status: DiagnosticStatus,
}

impl Robot {
    fn new(domain: u16, policy: &'static str) -> Self {
        let (context, node) = join(domain, "robot");
        let row = (0..WIDTH).flat_map(|x| {
            if x < WIDTH / 2 {
                [30, 20, 10]
            } else {
                [0, 0, 250]
            }
        });
        let row: Vec<u8> = row.chain((0..PADDING).map(|_| 77)).collect();
        let picture = Image {
            height: HEIGHT,
            width: WIDTH,
            encoding: "bgr8".into(),
            step: 3 * WIDTH + PADDING,
            data: row.repeat(HEIGHT as usize),
            ..Image::default()
        };
        Self {
            camera: node
                .publisher("/camera/image_raw", Qos::reliable(10))
                .unwrap(),
            joints: node.publisher("joint_states", Qos::reliable(10)).unwrap(),
            gripper: node.publisher("gripper", Qos::reliable(10)).unwrap(),
            instruction: node
                .publisher("/task/instruction", Qos::latched(1))
                .unwrap(),
            chunks: node
                .subscription("action_chunk", Qos::reliable(10))
                .unwrap(),
            diagnostics: node
                .subscription("/diagnostics", Qos::reliable(10))
                .unwrap(),
            node,
            _context: context,
            picture,
            ahead_ns: 0,
            has_joints: true,
            received: Vec::new(),
            policy,
            status: DiagnosticStatus::default(),
        }
    }

    fn instruct(&self, text: &str) {
        let data = text.to_owned();
        self.instruction.publish(&Text { data }).unwrap();
    }

    fn publish(&mut self) {
        let now_ns = self.node.now().to_nanos();
        self.gripper.publish(&Float64 { data: 0.25 }).unwrap();
        if self.has_joints {
            let joints = JointState {
                name: ["self", "elbow", "shoulder", "odd"]
                    .map(Into::into)
                    .to_vec(),
                // one too few
                position: vec![f64::NAN, 0.5, -1.0],
                ..JointState::default()
            };
            self.joints.publish(&joints).unwrap();
        }
        self.picture.header.stamp = Time::from_nanos(now_ns + self.ahead_ns);
        self.camera.publish(&self.picture).unwrap();
    }

    /// Publishes pictures and states until a condition holds. Keeps chunks and the policy's status.
    async fn until(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
        let work = async {
            let mut ticks = tokio::time::interval(Duration::from_millis(50));
            while !is_so(self) {
                tokio::select! {
                    _ = ticks.tick() => self.publish(),
                    chunk = self.chunks.recv() => self.received.push(chunk.unwrap().message),
                    array = self.diagnostics.recv() => {
                        let mut found = array.unwrap().message.status.into_iter();
                        if let Some(status) = found.find(|status| status.name == self.policy) {
                            self.status = status;
                        }
                    }
                }
            }
        };
        let done = tokio::time::timeout(PATIENCE, work).await.is_ok();
        assert!(done, "{}: no {what}; {:?}", self.policy, self.status);
    }

    async fn chunk(&mut self) -> ActionChunk {
        self.received.clear();
        self.until("chunk", |robot| !robot.received.is_empty())
            .await;
        self.received[0].clone()
    }

    fn drops(&self, reason: &str) -> u64 {
        let key = format!("dropped: {reason} [total]");
        let found = self.status.values.iter().find(|value| value.key == key);
        found.map_or(0, |value| value.value.parse().unwrap())
    }

    /// Waits until the policy drops another picture for this reason.
    async fn drop_of(&mut self, reason: &str) {
        let known = self.drops(reason);
        self.until(reason, |robot| robot.drops(reason) > known)
            .await;
    }
}

/// Checks times, frame and number of a chunk's actions; returns their values.
fn checked(chunk: &ActionChunk, count: usize) -> Vec<Vec<f32>> {
    let stamp = chunk.header.stamp;
    assert_eq!(chunk.header.frame_id, "arm_base");
    assert_eq!(chunk.period.to_nanos(), PERIOD_NS);
    assert_eq!(chunk.actions.len(), count);
    for (index, action) in chunk.actions.iter().enumerate() {
        assert_eq!(action.header.frame_id, "arm_base");
        let begin_ns = action.header.stamp.to_nanos() - stamp.to_nanos();
        assert_eq!(begin_ns, index as i64 * PERIOD_NS);
    }
    let timing = &chunk.timing;
    assert_eq!(timing.capture, stamp);
    let times = [timing.capture, timing.receive, timing.start, timing.end];
    assert!(times.is_sorted(), "{times:?}");
    assert!(
        timing.end.to_nanos() < stamp.to_nanos() + count as i64 * PERIOD_NS,
        "late"
    );
    chunk
        .actions
        .iter()
        .map(|action| action.values.clone())
        .collect()
}

#[tokio::test(flavor = "current_thread")]
async fn openpi_server_gets_observations_and_gives_chunks() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let port = free_port().to_string();
    let mut robot = Robot::new(domain, "openpi_policy");
    let address = format!("ws://localhost:{port}");
    let args = [
        "--server",
        &address,
        "--rate",
        "10",
        "--actions",
        "5",
        "--frame",
        "arm_base",
        "--state",
        "observation/state=shoulder,gripper*100",
        "--action",
        "a,b,c,d,e,f*0.01,g*-1+13",
    ];
    let bridge = Process::start(example(
        &peers,
        "policies",
        domain,
        "openpi_policy.py",
        &args,
    ));
    robot.drop_of("no_instruction").await;
    robot.instruct(INSTRUCTION);
    robot.drop_of("server").await;
    let _server = server(&peers, "policies", "openpi_server.py", &[&port], root());

    let values = checked(&robot.chunk().await, 5);
    let expected = |index| vec![index as f32, 10.0, 20.0, 30.0, -1.0, 0.25, 1.0];
    assert_eq!(values, (0..5).map(expected).collect::<Vec<_>>());

    for (instruction, reason) in [
        ("nan", "not_finite"),
        ("short", "shape"),
        ("slow", "late"),
        ("error", "server"),
    ] {
        robot.instruct(instruction);
        robot.drop_of(reason).await;
    }
    // neither bad answers nor bad inputs give chunks
    let is_good = |chunk: &ActionChunk| checked(chunk, 5)[0][6] == 1.0;
    assert!(robot.received.iter().all(is_good));
    robot.instruct(INSTRUCTION);
    assert!(is_good(&robot.chunk().await));
    robot.ahead_ns = -5_000_000_000;
    robot.drop_of("old_image").await;
    robot.ahead_ns = 0;
    robot.picture.encoding = "yuv422".into();
    robot.drop_of("bad_image").await;
    robot.picture.encoding = "bgr8".into();
    robot.has_joints = false;
    robot.drop_of("old_state").await;
    robot.has_joints = true;
    assert!(robot.received.iter().all(is_good));

    robot.instruct("silence");
    let waiting = "no answer of the server";
    robot
        .until(waiting, |robot| robot.status.message.starts_with(waiting))
        .await;
    bridge.signal(Signal::TERM);
    let (status, _) = bridge.finish(Duration::from_secs(10));
    assert!(
        status.success(),
        "ended with {status}, with an answer outstanding"
    );
}

#[tokio::test(flavor = "current_thread")]
async fn lerobot_server_gets_observations_and_gives_chunks() {
    let Some(peers) = peers() else { return };
    if !peers.join("lerobot/bin/python").is_file() {
        // eight gigabytes: failing would be wrong if nobody wanted it
        eprintln!(
            "skipped: no LeRobot under .venv/lerobot; run tests/setup_lerobot (LEROBOT=1 tests/run does)"
        );
        return;
    }
    pass(&peers, "lerobot", "test_lerobot_policy.py");
    pass(
        &peers,
        "lerobot",
        "imagined_policy/test_lerobot_checkpoint.py",
    );
    let domain = fresh_domain();
    let folder = tempfile::tempdir().unwrap();
    let port = free_port().to_string();
    let mut robot = Robot::new(domain, "lerobot_policy");
    robot.instruct(INSTRUCTION);
    let path = folder.path().to_str().unwrap();
    let serving = server(
        &peers,
        "lerobot",
        "lerobot_server.py",
        &[&port, path],
        folder.path(),
    );
    let address = format!("localhost:{port}");
    let checkpoint = format!("{path}/checkpoint");
    let start = |rate| {
        let args = [
            "--server",
            &address,
            "--rate",
            rate,
            "--policy",
            "act",
            "--checkpoint",
            &checkpoint,
            "--device",
            "cpu",
            "--actions",
            "8",
            "--frame",
            "arm_base",
            "--image",
            "front=/camera/image_raw",
            "--state",
            "observation.state=shoulder,gripper*100",
            "--action",
            "a,b,c,d,e,f*0.01,g*-1+13",
        ];
        Process::start(example(
            &peers,
            "lerobot",
            domain,
            "lerobot_policy.py",
            &args,
        ))
    };
    let bridge = start("10");
    let values = checked(&robot.chunk().await, 8);
    let expected = std::fs::read(folder.path().join("expected.json")).unwrap();
    let expected: Vec<Vec<f32>> = serde_json::from_slice(&expected).unwrap();
    for (values, expected) in values.iter().zip(&expected) {
        let [a, b, c, d, e, f, g] = expected[..] else {
            panic!("{expected:?}")
        };
        for (value, expected) in values.iter().zip([a, b, c, d, e, f * 0.01, 13.0 - g]) {
            assert!((value - expected).abs() < 1e-4, "{value} for {expected}");
        }
    }

    // a new server does not know the policy until it is set up again
    drop(serving);
    robot.drop_of("server").await;
    let _serving = server(
        &peers,
        "lerobot",
        "lerobot_server.py",
        &[&port, path],
        folder.path(),
    );
    checked(&robot.chunk().await, 8);

    bridge.signal(Signal::TERM);
    let (status, _) = bridge.finish(Duration::from_secs(10));
    assert!(status.success(), "ended with {status}");
    // the server counts 10 actions per second
    let _bridge = start("20");
    robot.drop_of("period").await;
}

/// Runs the Python tests of an example.
fn pass(peers: &Path, packages: &str, script: &str) {
    let tests = example(peers, packages, fresh_domain(), script, &[]);
    let (status, _) = Process::start(tests).finish(PATIENCE);
    assert!(status.success(), "{script}: {status}");
}

#[test]
fn malformed_pictures_and_answers_are_refused() {
    let Some(peers) = peers() else { return };
    pass(&peers, "policies", "test_policy_bridge.py");
}
