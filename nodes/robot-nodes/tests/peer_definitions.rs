//! The recorder beside a real rclpy publisher of a type that neither this suite nor `AMENT_PREFIX_PATH` has.

use crate::fresh_domain::fresh_domain;
use std::{
    io::{BufRead as _, BufReader, Read as _},
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use crate::ros2_peer::{in_domain, peers, rclpy};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;
use wm_bag::{BagReader, SchemaEncoding};
use wm_ros::NodeArgs;

/// Far above anything that a test takes; it only ends one that hangs.
const PATIENCE: Duration = Duration::from_secs(60);
const TYPE: &str = "geometry_msgs/msg/PolygonStamped";

/// A process that is killed when the test lets go of it.
struct Process(Child);

impl Process {
    fn start(mut command: Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        Self(command.spawn().unwrap())
    }

    /// Waits for its end after a signal.
    fn interrupt(mut self) {
        kill_process(Pid::from_child(&self.0), Signal::INT).unwrap();
        self.0.wait().unwrap();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// The recorder, until a signal.
#[test]
#[ignore = "started by the tests of this file"]
fn recorder() {
    let output = std::env::var("OUTPUT").expect("started by another test");
    let output = format!("output:={output}");
    let args = ["--ros-args", "-p", &output, "-p", "topics:=[/zone]"];
    let args = NodeArgs::parse(args.map(str::to_owned)).unwrap();
    (wm_robot_nodes::recorder::NODE.run)(&args).unwrap();
}

/// A bag of at least ten messages of `polygons.py`, with the recorder's log.
fn recorded(peers: &Path, domain: u16, service: &str) -> (TempDir, BagReader, String) {
    let scratch = TempDir::new().unwrap();
    let bag = scratch.path().join("bag");
    let mut publisher = Process::start(rclpy(peers, domain, "polygons.py", &[service]));
    let stdout = BufReader::new(publisher.0.stdout.take().unwrap());
    let first = stdout.lines().map_while(Result::ok).next();
    assert_eq!(first.as_deref(), Some("publishing"));
    let log = scratch.path().join("log");
    let mut recorder = Command::new(std::env::current_exe().unwrap());
    recorder
        .args([
            "--ignored",
            "--exact",
            "--nocapture",
            "peer_definitions::recorder",
        ])
        .env("OUTPUT", &bag)
        .env_remove("AMENT_PREFIX_PATH")
        .stderr(std::fs::File::create(&log).unwrap());
    in_domain(&mut recorder, domain);
    let recorder = Process::start(recorder);
    let begin = Instant::now();
    let count = || BagReader::open(&bag).map_or(0, |reader| reader.message_count());
    while count() < 10 {
        assert!(begin.elapsed() < PATIENCE, "nothing is recorded");
        // A bag has no event for a message that is on the disk.
        std::thread::sleep(Duration::from_millis(100));
    }
    recorder.interrupt();
    let mut text = String::new();
    let mut log = std::fs::File::open(&log).unwrap();
    log.read_to_string(&mut text).unwrap();
    let reader = BagReader::open(&bag).unwrap();
    (scratch, reader, text)
}

/// Domains up to 101 keep RTPS ports below the ephemeral range of Linux.
#[test]
fn live_publisher_gives_the_definition_of_an_unknown_type() {
    let Some(peers) = peers() else { return };
    let (_scratch, reader, log) = recorded(&peers, fresh_domain(), "with");
    let topic = reader.topic("/zone").unwrap();
    assert_eq!(topic.schema.encoding, SchemaEncoding::Ros2Msg, "{log}");
    let text = &topic.schema.text;
    let own = "std_msgs/Header header\ngeometry_msgs/Polygon polygon\n";
    assert!(text.starts_with(own), "{text}");
    for part in [
        "builtin_interfaces/Time",
        "geometry_msgs/Point32",
        "std_msgs/Header",
    ] {
        assert!(text.contains(&format!("\nMSG: {part}\n")), "{text}");
    }
    assert!(topic.schema.type_hash(TYPE).unwrap().is_some());
    assert!(!log.contains("without its definition"), "{log}");
    // Messages that came while the definition was requested are there.
    let heights: Vec<f32> = reader
        .messages()
        .map(|message| {
            let data = message.unwrap().data;
            f32::from_le_bytes(*data.last_chunk().unwrap())
        })
        .collect();
    let is_next = |pair: &[f32]| (pair[1] - pair[0] - 1.0).abs() < 1e-3;
    assert!(heights.windows(2).all(is_next), "{heights:?}");
}

#[test]
fn unknown_type_without_the_service_is_recorded_undefined() {
    let Some(peers) = peers() else { return };
    let (_scratch, reader, log) = recorded(&peers, fresh_domain(), "without");
    let topic = reader.topic("/zone").unwrap();
    let undefined = SchemaEncoding::Other(String::new());
    assert_eq!(topic.schema.encoding, undefined);
    assert!(log.contains("recorded without its definition"), "{log}");
}
