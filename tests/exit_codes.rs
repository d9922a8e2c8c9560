//! Exit codes and errors of commands that fail.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use wm_bag::{BagReader, BagWriter, QosProfile, WriterOptions};
use wm_msgs::wm_msgs::Prediction;

use crate::harness::{
    Process, Signal, bundled_bag, fresh_domain, root, wait_until, whole_suite, wm, wm_node,
};

/// Exit code, standard output and standard error of `wm` with these arguments.
fn run(args: &[&str]) -> (Option<i32>, String, String) {
    let run = wm(fresh_domain(), args).output().expect("wm runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (run.status.code(), text(&run.stdout), text(&run.stderr))
}

#[test]
fn replay_without_a_bag_fails_once_without_report() {
    let _alone = whole_suite();
    let out = tempfile::tempdir().expect("a temporary directory");
    let (code, stdout, stderr) = run(&[
        "launch",
        "launch-configs/replay.launch.yaml",
        "bag:=/no/such/bag",
        &format!("output:={}", out.path().display()),
    ]);
    assert_eq!(code, Some(1), "{stderr}");
    assert_eq!(stderr.matches("/no/such/bag").count(), 1, "{stderr}");
    assert!(!stdout.contains("PSNR"), "{stdout}");
    assert!(!out.path().join("report.json").exists());
}

/// A device that does not exist or was not built is not replaced by another.
#[test]
#[cfg(not(feature = "cuda"))]
fn error_for_unusable_device_names_what_is_missing() {
    let _alone = whole_suite();
    for node in [
        "encoder",
        "predictor",
        "decoder",
        "planner",
        "evaluator",
        "env",
    ] {
        let (code, _, stderr) = run(&[node, "--ros-args", "-p", "device:=gpu"]);
        assert_eq!(code, Some(1), "{node}: {stderr}");
        assert!(
            stderr.contains("expected cpu, cuda or cuda:N"),
            "{node}: {stderr}"
        );
        let (code, _, stderr) = run(&[node, "--ros-args", "-p", "device:=cuda:1"]);
        assert_eq!(code, Some(1), "{node}: {stderr}");
        assert!(
            stderr.contains("device cuda:1") && stderr.contains("feature `cuda`"),
            "{node}: {stderr}"
        );
    }
}

/// The files in a folder by relative path, with their bytes.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            let bytes = std::fs::read(&path).expect("a file");
            found.insert(path, bytes);
        }
    }
    found
}

#[test]
fn mistyped_bag_leaves_an_older_job_unchanged() {
    let _alone = whole_suite();
    let out = tempfile::tempdir().expect("a temporary directory");
    let bag = out.path().join("bag");
    std::fs::create_dir(&bag).expect("a new folder");
    for name in ["bag/bag_0.mcap", "bag/metadata.yaml", "report.md"] {
        std::fs::write(out.path().join(name), name).expect("a new file");
    }
    let before = contents(out.path());
    let output = format!("output:={}", out.path().display());
    let launch = |arguments: &[&str]| {
        let file = "launch-configs/replay.launch.yaml";
        run(&[&["launch", file, &output][..], arguments].concat())
    };
    let (code, _, stderr) = launch(&["bag:=nope"]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.contains("player-7") && stderr.contains("nope"),
        "{stderr}"
    );
    // nothing has started that could have removed it
    assert!(!stderr.contains("[recorder"), "{stderr}");

    // a camera that the bag lacks is an error that lists the bag's cameras
    let (code, _, stderr) = launch(&["camera:=/front/image_raw"]);
    assert_eq!(code, Some(1), "{stderr}");
    for named in ["/front/image_raw", "/camera/image_raw/compressed"] {
        assert!(stderr.contains(named), "{named}: {stderr}");
    }
    assert!(!stderr.contains("[recorder"), "{stderr}");

    // missing actions, a camera's sibling, and a missing or incomplete model are errors too
    let half = tempfile::tempdir().expect("a temporary directory");
    let tiny = root().join("world-model/model/weights/tiny/autoencoder.safetensors");
    std::fs::copy(tiny, half.path().join("autoencoder.safetensors")).expect("a new file");
    let half = format!("model:={}", half.path().display());
    for (wrong, told) in [
        (half.as_str(), "no transition model"),
        (
            "camera:=/camera/image_raw/compressed",
            "belongs to, /camera/image_raw:",
        ),
        ("action:=/front/action", "it has them on: /wm/action"),
        ("model:=nowhere", "nowhere: no such folder"),
        ("model:=launch-configs", "no model.json"),
    ] {
        for one_process in ["one_process:=false", "one_process:=true"] {
            let (code, _, stderr) = launch(&[wrong, one_process]);
            assert_eq!(code, Some(1), "{stderr}");
            assert_eq!(stderr.matches(told).count(), 1, "{told}: {stderr}");
            assert_eq!(stderr.lines().count(), 1, "{stderr}");
        }
    }

    // another program has the page's port
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a free port");
    let port = taken.local_addr().expect("it is bound").port();
    let (code, _, stderr) = launch(&["view:=true", &format!("view_port:={port}")]);
    assert_eq!((code, stderr.lines().count()), (Some(1), 1), "{stderr}");
    assert!(stderr.contains(&format!("127.0.0.1:{port}")), "{stderr}");
    assert_eq!(contents(out.path()), before);
}

#[test]
fn monitor_without_input_names_the_missing_topics() {
    let out = tempfile::tempdir().expect("a temporary directory");
    let (code, text) = interrupted_monitor(out.path(), None);
    assert_eq!(code, Some(1), "{text}");
    for topic in ["/camera/image_raw/compressed", "/wm/predicted", "/wm/plan"] {
        assert!(text.contains(topic), "{topic}: {text}");
    }
    // a camera alone is not enough either
    let (code, text) = interrupted_monitor(out.path(), Some(&bundled_bag()));
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("/wm/predicted") && text.contains("Hz"),
        "{text}"
    );
    assert!(out.path().join("report.json").exists());
}

#[test]
fn report_of_a_bag_without_predictions_is_an_error() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let mut writer = BagWriter::create(at("bag"), WriterOptions::default()).expect("a new bag");
    let bundled = BagReader::open(bundled_bag()).expect("the bundled bag");
    for message in bundled.messages() {
        let message = message.expect("a whole message");
        let topic = bundled.topic(&message.topic).expect("its topic");
        let (name, time) = (&*message.topic, message.log_time_ns);
        writer
            .write_raw(name, &topic.type_name, &topic.schema, time, &message.data)
            .expect("it is written");
    }
    // the predictor existed, but predicted nothing
    writer
        .add_topic::<Prediction>("/wm/predicted", QosProfile::sensor_data())
        .expect("a new topic");
    writer.finish().expect("the end of the bag");
    let (code, _, stderr) = run(&["report", &at("bag"), "-o", &at("out")]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.contains("no prediction") && stderr.contains("5.00 Hz"),
        "{stderr}"
    );
}

/// SIGINT before a node has its handlers kills the node, and a launch then reports it as failed. So the handlers come
/// before slow steps such as sockets.
#[test]
fn node_handles_signals_before_it_joins_the_graph() {
    /// The number of SIGINT, as a bit of `SigCgt`.
    const SIGINT: u64 = 1 << (2 - 1);
    let out = tempfile::tempdir().expect("a temporary directory");
    let output = format!("output:={}/bag", out.path().display());
    let node = Process::start(wm(
        fresh_domain(),
        &["recorder", "--ros-args", "-p", &output],
    ));
    let proc = PathBuf::from(format!("/proc/{}", node.pid().as_raw_nonzero()));
    let catches = || {
        let status = std::fs::read_to_string(proc.join("status")).expect("the process runs");
        let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
        let mask = u64::from_str_radix(mask.expect("a mask").trim(), 16);
        mask.expect("a number") & SIGINT != 0
    };
    let has_socket = || {
        // of DDS and of Zenoh
        let tables = ["net/udp", "net/tcp"].map(|table| {
            let table = std::fs::read_to_string(proc.join(table));
            table.expect("the process runs")
        });
        let inodes: Vec<&str> = tables
            .iter()
            .flat_map(|table| table.lines())
            .filter_map(|line| line.split_whitespace().nth(9))
            .collect();
        let links = std::fs::read_dir(proc.join("fd")).expect("the process runs");
        links
            .filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok())
            .any(|link| {
                let inode = link.to_string_lossy();
                let inode = inode
                    .strip_prefix("socket:[")
                    .and_then(|text| text.strip_suffix(']'));
                inode.is_some_and(|inode| inodes.contains(&inode))
            })
    };
    let start = Instant::now();
    while !has_socket() {
        assert!(start.elapsed() < Duration::from_secs(30), "no socket");
    }
    assert!(catches(), "a signal would end it now");
    node.signal(Signal::INT);
    let (status, _) = node.finish(Duration::from_secs(30));
    assert_eq!(status.code(), Some(0), "{status}");
}

/// Exit code and standard error of a monitor that gets SIGINT when it works, or after a bag was played to it.
fn interrupted_monitor(out: &Path, bag: Option<&Path>) -> (Option<i32>, String) {
    let domain = fresh_domain();
    let output = format!("output:={}", out.display());
    let mut monitor = Process::start(wm_node(domain, "monitor", &[&output]));
    let is_working = || monitor.stderr().contains("camera ");
    wait_until("the live line", Duration::from_secs(30), is_working);
    if let Some(bag) = bag {
        let wait = ["--wait-for", "/camera/image_raw/compressed"];
        let topics = ["--topics", "/camera/image_raw/compressed"];
        let play = ["bag", "play", &bag.to_string_lossy()];
        let player = Process::start(wm(domain, &[&play[..], &wait, &topics].concat()));
        let (status, _) = player.finish(Duration::from_secs(60));
        assert!(status.success(), "{status}");
    }
    monitor.signal(Signal::INT);
    let status = monitor.ended(Duration::from_secs(30));
    (status.code(), monitor.stderr())
}

#[test]
fn unknown_arguments_and_parameters_are_wrong_usage() {
    let launch = "launch-configs/replay.launch.yaml";
    for (args, named) in [
        (&["launch", launch, "nope:=1"][..], "nope"),
        (&["launch", launch, "bag:=a", "bag:=b"], "twice"),
        (&["monitor", "--ros-args", "-p", "nope:=1"], "nope"),
        (
            &["monitor", "--ros-args", "-p", "live_line:=7"],
            "live_line",
        ),
        (&["monitor", "--nope"], "nope"),
        (&["bag", "record", "-o", "never"], "--topic-types"),
        (&["bag", "play", "never", "--rate", "0"], "rate"),
        (
            &["bag", "play", "never", "--clock", "--restamp"],
            "--restamp",
        ),
    ] {
        let (code, _, stderr) = run(args);
        assert_eq!(code, Some(2), "{args:?}: {stderr}");
        assert!(stderr.contains(named), "{args:?}: {stderr}");
    }
}

#[test]
fn info_of_a_truncated_bag_exits_with_3() {
    let whole = bundled_bag().join("episode_2000010_0.mcap");
    let dir = tempfile::tempdir().expect("a temporary directory");
    let cut = dir.path().join("cut.mcap");
    let mut bytes = std::fs::read(&whole).expect("the bundled bag");
    bytes.truncate(bytes.len() / 2);
    std::fs::write(&cut, bytes).expect("the file is writable");

    let (code, stdout, stderr) = run(&["bag", "info", &cut.to_string_lossy()]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stdout.contains("truncated") && stdout.contains("Messages:"),
        "{stdout}"
    );
    let (code, ..) = run(&["bag", "info", &whole.to_string_lossy()]);
    assert_eq!(code, Some(0));
}

/// Copies a bag in small chunks, and returns its file. The bundled bag has one chunk, of which no part can be
/// recovered.
fn in_chunks(bag: &Path, to: &str) -> PathBuf {
    let reader = BagReader::open(bag).expect("the bag");
    let options = WriterOptions {
        chunk_size: 16 << 10,
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(to, options).expect("a new bag");
    for message in reader.messages() {
        let message = message.expect("a whole message");
        let topic = reader.topic(&message.topic).expect("its topic");
        let (name, time) = (&*message.topic, message.log_time_ns);
        writer
            .write_raw(name, &topic.type_name, &topic.schema, time, &message.data)
            .expect("it is written");
    }
    let mut summary = writer.finish().expect("the bag is closed");
    summary.files.remove(0)
}

#[test]
fn recover_and_cut_exit_with_3_after_loss() {
    let whole = bundled_bag();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let mut bytes = std::fs::read(in_chunks(&whole, &at("chunks"))).expect("the copy");
    bytes.truncate(bytes.len() / 2);
    std::fs::write(at("cut.mcap"), bytes).expect("the file is writable");

    let (code, stdout, stderr) = run(&["bag", "recover", &at("cut.mcap"), &at("recovered")]);
    assert_eq!(code, Some(3), "{stderr}");
    assert!(
        stdout.contains("recovered") && stdout.contains("bytes at byte"),
        "{stdout}"
    );
    let (code, stdout, _) = run(&["bag", "recover", &whole.to_string_lossy(), &at("same")]);
    assert_eq!(code, Some(0), "{stdout}");
    assert!(stdout.contains("lost: nothing"), "{stdout}");

    let part = ["--start-offset", "1", "--duration", "1", "-e", "^/camera/"];
    let cut = |from: &str, to: &str, options: &[&str]| {
        run(&[&["bag", "cut", from, to][..], options].concat())
    };
    let (code, _, stderr) = cut(&at("recovered"), &at("part"), &part);
    assert_eq!(code, Some(0), "{stderr}");
    let (code, ..) = cut(&at("cut.mcap"), &at("damaged_part"), &part);
    assert_eq!(code, Some(3));
    let (code, stdout, _) = run(&["bag", "info", &at("part")]);
    assert_eq!(code, Some(0));
    assert!(
        stdout.contains("/camera/") && !stdout.contains("/wm/action"),
        "{stdout}"
    );
    for (options, expected) in [
        (&["--start-time", "yesterday"][..], 2),
        (&["--start-time", "1", "--start-offset", "1"], 2),
        (&["--topics", "/absent"], 1),
    ] {
        let (code, _, stderr) = cut(&at("same"), &at("never"), options);
        assert_eq!(code, Some(expected), "{options:?}: {stderr}");
    }
    let record = ["bag", "record", "-a", "-o", &at("never")];
    for mode in ["file", "message"] {
        let (code, _, stderr) = run(&[&record[..], &["--compression-mode", mode]].concat());
        assert_eq!(code, Some(2), "{stderr}");
        assert!(stderr.contains("--compression-format"), "{stderr}");
    }
}
