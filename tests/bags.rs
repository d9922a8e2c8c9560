//! A real rclpy controls player and recorder.

use std::{path::Path, time::Duration};

use serde_json::{Value, json};
use wm_bag::BagReader;

use crate::harness::{
    Process, Signal, WM, bundled_bag, fresh_domain, peers, rclpy, tool, wait_until, wm,
};

fn steps(peers: &Path, domain: u16, args: &[&str]) -> Vec<Value> {
    let args = [&["--seconds", "30"], args].concat();
    let peer = Process::start(rclpy(peers, domain, "rosbag2.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(120));
    assert!(status.success(), "rosbag2.py: {status}");
    serde_json::from_str(&stdout).expect("rosbag2.py prints JSON")
}

fn came(step: &Value) -> u64 {
    let counts = step["messages"].as_object().expect("counts by topic");
    counts.values().filter_map(Value::as_u64).sum()
}

/// The times on `/clock` after a call \[ns\], checked not to go back.
fn clock(step: &Value) -> Vec<u64> {
    let times = step["clock"].as_array().expect("times").iter();
    let times: Vec<u64> = times.filter_map(Value::as_u64).collect();
    assert!(!times.is_empty() && times.is_sorted(), "{step}");
    times
}

#[test]
fn rclpy_pauses_steps_and_seeks_a_player() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let bag = bundled_bag();
    let reader = BagReader::open(&bag).expect("the bundled bag");
    let (start, end) = (reader.start_ns(), reader.end_ns());
    let actions = reader.topic("/wm/action").expect("actions").message_count;
    let _player = Process::start(wm(
        domain,
        &[
            "bag",
            "play",
            &bag.to_string_lossy(),
            "--start-paused",
            "--clock",
            "100",
            "--topics",
            "/wm/action",
            "--ros-args",
            "-p",
            "linger:=120.0",
        ],
    ));
    let time =
        |ns: u64| json!({"time": {"sec": ns / 1_000_000_000, "nanosec": ns % 1_000_000_000}});
    let seek = |ns: u64| format!("seek={}", time(ns));
    let (back, behind) = (seek(start), seek(end + 1));
    let asked = [
        "is_paused",
        "play_next",
        r#"burst={"num_messages": 3}"#,
        "get_rate",
        r#"set_rate={"rate": -1.0}"#,
        r#"set_rate={"rate": 2.0}"#,
        "resume",
        "play_next",
        "pause",
        back.as_str(),
        behind.as_str(),
        "burst",
        "toggle_paused",
        "stop",
        "play",
        "play",
        "is_paused",
    ];
    let mut args = vec!["--topic", "/wm/action:wm_msgs/msg/Action", "/wm/player"];
    args.extend(asked);
    let made = steps(&peers, domain, &args);
    let answers: Vec<&Value> = made.iter().map(|step| &step["response"]).collect();
    let nothing = json!({});
    let success = |success: bool| json!({ "success": success });
    assert_eq!(
        [answers[0], answers[1], answers[2], answers[3]],
        [
            &json!({"paused": true}),
            &success(true),
            &json!({"actually_burst": 3}),
            &json!({"rate": 1.0})
        ]
    );
    assert_eq!([answers[4], answers[5]], [&success(false), &success(true)]);
    assert_eq!([answers[6], answers[8], answers[13]], [&nothing; 3]);
    assert_eq!(answers[7], &success(false), "it is not paused");
    assert_eq!([answers[9], answers[10]], [&success(true), &success(false)]);
    assert_eq!(answers[11], &json!({ "actually_burst": actions }));
    assert_eq!(
        [answers[14], answers[15]],
        [&success(true), &success(false)]
    );

    // a paused player publishes only on request, and its clock stops
    assert_eq!(clock(&made[0]).last(), Some(&start));
    assert_eq!((came(&made[0]), came(&made[1]), came(&made[2])), (0, 1, 3));
    let stands = clock(&made[3]);
    assert_eq!(stands.first(), stands.last());
    assert!(came(&made[6]) > 0);
    let runs = clock(&made[6]);
    let ran = runs[runs.len() - 1] - runs[0];
    assert!(
        (500_000_000..2_000_000_000).contains(&ran),
        "half a second at rate 2, not {ran} ns"
    );
    assert_eq!(clock(&made[9]).last(), Some(&start), "the clock went back");
    assert_eq!(came(&made[11]), actions);
    assert_eq!(clock(&made[11]).last().map(|last| *last <= end), Some(true));
    assert_eq!(made[13]["clock"], json!([]), "no clock without playback");
    assert!(came(&made[14]) + came(&made[15]) > 0);
}

#[test]
fn keys_control_a_player_and_the_terminal_is_restored() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let bag = bundled_bag();
    let bag = bag.to_string_lossy();
    let args = [
        "--seconds",
        "30",
        "/wm/player",
        WM,
        "bag",
        "play",
        &bag,
        "-p",
        "--loop",
    ];
    let peer = Process::start(rclpy(&peers, domain, "keys.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(120));
    assert!(status.success(), "keys.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("keys.py prints JSON");
    assert_eq!(
        answer,
        json!({
            "states": [
                ["", true, 1.0], ["space", false, 1.0], ["up", false, 1.1], ["down", false, 1.0], ["x", false, 1.0],
                ["space again", true, 1.0],
            ],
            "changed": true,
            "code": 0,
            "restored": true,
        })
    );
}

#[test]
fn rclpy_pauses_splits_and_restarts_a_recorder() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let first = at("first");
    let recorder = Process::start(wm(
        domain,
        &["bag", "record", "-e", "^/count", "-o", &first],
    ));
    let again = format!(r#"record={{"uri": "{}"}}"#, at("second"));
    let taken = format!(r#"record={{"uri": "{first}"}}"#);
    let asked = [
        "is_paused",
        "pause",
        "is_paused",
        "resume",
        "split_bagfile",
        &again,
        "stop",
        &taken,
        &again,
        "pause",
    ];
    let mut args = vec!["--publish", "/count", "/wm/recorder"];
    args.extend(asked);
    let made = steps(&peers, domain, &args);
    let answers: Vec<&Value> = made.iter().map(|step| &step["response"]).collect();
    assert_eq!(answers[0]["paused"], false);
    assert_eq!(answers[2]["paused"], true);
    assert_eq!(
        [answers[1], answers[3], answers[4], answers[6]],
        [&json!({}); 4]
    );
    assert_eq!(answers[5]["return_code"], 1, "it is recording");
    assert_eq!(answers[7]["return_code"], 1, "there is a bag already");
    assert!(
        answers[7]["error_string"]
            .as_str()
            .expect("text")
            .contains("first")
    );
    assert_eq!(answers[8], &json!({"return_code": 0, "error_string": ""}));
    recorder.signal(Signal::INT);
    let (status, stdout) = recorder.finish(Duration::from_secs(10));
    assert!(
        status.success(),
        "nothing was lost, so not {status}: {stdout}"
    );
    assert_eq!(stdout.matches("recorded ").count(), 2, "{stdout}");

    let numbers = |bag: &str| -> Vec<u64> {
        let reader = BagReader::open(bag).expect("a bag");
        let texts = reader.messages().map(|message| {
            let message = message.expect("a message");
            message.decode::<wm_msgs::std_msgs::String>().expect("text")
        });
        texts
            .map(|text| text.data.parse().expect("a number"))
            .collect()
    };
    let of_first = numbers(&first);
    let gaps: Vec<u64> = of_first.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let longest = gaps.iter().max().expect("numbers");
    assert!(
        *longest >= 30,
        "a second of 50 Hz was left out, not {longest}"
    );
    assert_eq!(gaps.iter().filter(|gap| **gap > 1).count(), 1, "{gaps:?}");
    assert_eq!(
        std::fs::read_dir(&first).expect("a folder").count(),
        3,
        "two files and their metadata"
    );
    let of_second = numbers(&at("second"));
    assert!(of_second.first() > of_first.last());
}

/// A folder with a file that a recorder could mistake for an old bag.
fn recorded(folder: &Path) {
    std::fs::create_dir_all(folder).expect("a new folder");
    std::fs::write(folder.join("a.mcap"), "recorded").expect("a new file");
}

fn is_kept(folder: &Path) -> bool {
    std::fs::read(folder.join("a.mcap")).is_ok_and(|bytes| bytes == b"recorded")
}

/// `overwrite` applies to the bag that the user named, never to one that a peer requests.
#[test]
fn peers_cannot_overwrite_a_recording() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let root = dir.path().join("root");
    let [first, foreign, outside] =
        ["root/first", "root/foreign", "outside"].map(|name| dir.path().join(name));
    recorded(&foreign);
    recorded(&outside);
    std::os::unix::fs::symlink(&outside, root.join("link")).expect("a new link");
    let path = first.to_string_lossy();
    let _recorder = Process::start(wm(
        domain,
        &["bag", "record", "-a", "--overwrite", "-o", &path],
    ));
    let record = |uri: &str| format!(r#"record={{"uri": "{uri}"}}"#);
    let refused = [
        record(&path),
        record("first"),
        record(&foreign.to_string_lossy()),
        record("foreign"),
        record("../outside"),
        record(&outside.to_string_lossy()),
        record("link"),
        record("link/new"),
    ];
    let mut args = vec!["--publish", "/count", "/wm/recorder", "is_paused", "stop"];
    args.extend(refused.iter().map(String::as_str));
    let (empty, below) = (record(""), record("day/second"));
    args.extend([&empty, "stop", &below, "stop"]);
    let made = steps(&peers, domain, &args);
    let answers: Vec<&Value> = made.iter().map(|step| &step["response"]).collect();
    for (uri, answer) in refused.iter().zip(&answers[2..]) {
        assert_eq!(answer["return_code"], 1, "{uri}");
        assert_ne!(answer["error_string"], "", "{uri}");
    }
    let begun = json!({"return_code": 0, "error_string": ""});
    assert_eq!([answers[10], answers[12]], [&begun; 2]);
    assert!(is_kept(&foreign) && is_kept(&outside));
    let messages = |bag: &Path| BagReader::open(bag).expect("a bag").message_count();
    assert!(messages(&first) > 0, "it is as it was when it was closed");
    assert!(messages(&root.join("day/second")) > 0);
    let mut names: Vec<String> = std::fs::read_dir(&root)
        .expect("the root")
        .map(|entry| entry.expect("an entry").file_name())
        .map(|name| name.to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names.len(), 5, "{names:?}");
    assert!(names[2].starts_with("first_2"), "{names:?}");
    assert!(messages(&root.join(&names[2])) > 0);
    assert_eq!(std::fs::read_dir(&outside).expect("a folder").count(), 1);
}

/// DDS allows names that ROS does not, and anyone may publish. Neither these nor many topics may end a recorder or
/// flood its log.
#[test]
fn recorder_survives_odd_names_and_many_topics() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let bag = dir.path().join("bag");
    let mut recorder = Process::start(wm(
        domain,
        &["bag", "record", "-a", "-o", &bag.to_string_lossy()],
    ));
    let odd = ["rt/a-b", "rt/../../etc", "rt/1st"];
    let many: Vec<String> = (0..300)
        .map(|number| format!("rt/many/topic_{number}"))
        .collect();
    let names: Vec<&str> = odd
        .into_iter()
        .chain(many.iter().map(String::as_str))
        .collect();
    let _peer = Process::start(tool(&peers, domain, "odd_names.py", &names));
    let file = bag.join("bag_0.mcap");
    let is_recorded = |name: &str| {
        let reader = BagReader::open(&file).expect("what there is of the bag");
        let topic = reader.topic(name);
        topic.is_some_and(|topic| topic.message_count > 0)
    };
    wait_until("odd names", Duration::from_secs(60), || {
        odd.iter().all(|name| {
            recorder
                .stderr()
                .contains(&format!("{} (std_msgs", &name[2..]))
        })
    });
    wait_until("the last topic", Duration::from_secs(60), || {
        is_recorded("/many/topic_299")
    });
    recorder.signal(Signal::INT);
    let status = recorder.ended(Duration::from_secs(30));
    assert!(matches!(status.code(), Some(0 | 3)), "{status}");
    let said = recorder.stderr();
    assert_eq!(said.matches("is not recorded").count(), odd.len());
    let (_, stdout) = recorder.finish(Duration::ZERO);
    assert!(!stdout.contains("of /rosout"), "{stdout}");
    let reader = BagReader::open(&bag).expect("the bag");
    assert!(odd.iter().all(|name| reader.topic(&name[2..]).is_none()));
}

#[test]
fn existing_recording_stays_without_overwrite() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let bag = dir.path().join("bag");
    let path = bag.to_string_lossy().into_owned();
    let others = || {
        let paths = std::fs::read_dir(dir.path()).expect("the folder");
        let paths = paths.map(|entry| entry.expect("an entry").path());
        paths.filter(|path| *path != bag).collect::<Vec<_>>()
    };
    let record = |renamed: usize| {
        let args = ["bag", "record", "-a", "-o", &path, "--rename-existing"];
        let recorder = Process::start(wm(fresh_domain(), &args));
        let file = bag.join("bag_0.mcap");
        wait_until("a recording", Duration::from_secs(30), || {
            others().len() == renamed && file.is_file()
        });
        recorder.signal(Signal::INT);
        let (status, _) = recorder.finish(Duration::from_secs(30));
        assert!(status.success(), "{status}");
    };
    recorded(&bag);
    record(1);
    assert!(is_kept(&others()[0]));
    record(2);

    // it is refused by default
    let run = wm(fresh_domain(), &["bag", "record", "-a", "-o", &path]).output();
    let run = run.expect("wm runs");
    assert_eq!(run.status.code(), Some(1));
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(said.contains("already exists"), "{said}");
}

#[test]
fn snapshot_contains_earlier_messages() {
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let bag = dir.path().join("last").to_string_lossy().into_owned();
    // a message counts its own few bytes and about a hundred for storage
    let args = [
        "bag",
        "record",
        "/count",
        "-o",
        &bag,
        "--snapshot-mode",
        "--max-cache-size",
        "2000",
    ];
    let recorder = Process::start(wm(domain, &args));
    let asked = [
        "--publish",
        "/count",
        "/wm/recorder",
        "is_paused",
        "snapshot",
        "is_paused",
    ];
    let made = steps(&peers, domain, &asked);
    assert_eq!(made[1]["response"], json!({"success": true}));
    recorder.signal(Signal::INT);
    let (status, stdout) = recorder.finish(Duration::from_secs(10));
    assert!(status.success(), "{status}: {stdout}");
    let reader = BagReader::open(&bag).expect("a bag");
    let count = reader.message_count();
    assert!(
        (5..50).contains(&count),
        "the last few of a second's 50, not {count}"
    );
}

/// A bag without QoS, played from its middle: the recorder subscribes to latched topics like any node.
#[test]
fn replay_from_the_middle_publishes_latched_state() {
    const START_NS: u64 = 1_750_000_000_000_000_000;
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let text = |data: &str| wm_msgs::std_msgs::String { data: data.into() };
    let options = wm_bag::WriterOptions::default();
    let mut writer = wm_bag::BagWriter::create(at("old"), options).expect("a new bag");
    let schema = wm_bag::type_schema::<wm_msgs::std_msgs::String>();
    for (second, topic, data) in [
        (0, "/task/instruction", "push"),
        (1, "/task/instruction", "pull"),
        (2, "/note", "before"),
        // an hour without messages, which is skipped
        (3600, "/note", "after"),
    ] {
        let type_name = "std_msgs/msg/String";
        let added = writer.add_topic_raw(topic, type_name, &schema, "");
        added.expect("a topic without QoS");
        let time_ns = START_NS + second * 1_000_000_000;
        writer
            .write(topic, &text(data), time_ns)
            .expect("a message");
    }
    writer.finish().expect("the bag's end");

    let new = at("new");
    let args = ["bag", "record", "/task/instruction", "/note", "-o", &new];
    let recorder = Process::start(wm(domain, &args));
    let (old, wait) = (at("old"), "--wait-for");
    let args = [
        "bag",
        "play",
        &old,
        "--start-offset",
        "1.5",
        wait,
        "/note",
        wait,
        "/task/instruction",
    ];
    let player = Process::start(wm(domain, &args));
    let (status, stdout) = player.finish(Duration::from_secs(60));
    assert!(status.success(), "{status}: {stdout}");
    recorder.signal(Signal::INT);
    let (status, stdout) = recorder.finish(Duration::from_secs(10));
    assert!(status.success(), "{status}: {stdout}");

    let reader = BagReader::open(&new).expect("a bag");
    let mut came: Vec<String> = reader
        .messages()
        .map(|message| message.expect("a message").decode())
        .map(|text: Result<wm_msgs::std_msgs::String, _>| text.expect("text").data)
        .collect();
    came.sort();
    assert_eq!(came, ["after", "before", "pull"]);
    assert!(
        reader
            .topic("/task/instruction")
            .expect("the topic")
            .is_latched()
    );
}
