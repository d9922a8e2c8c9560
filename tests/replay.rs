//! The main job: one command replays the bundled bag through the nodes and writes a report.

use std::{
    collections::BTreeSet,
    path::Path,
    time::{Duration, SystemTime},
};

use wm_bag::{BagReader, BagWriter, WriterOptions};
use wm_msgs::diagnostic_msgs::DiagnosticArray;

use crate::harness::{
    Process, Signal, bundled_bag, children, fresh_domain, looping_player, over_zenoh, wait_until,
    whole_suite, wm,
};

/// Runs the main job into `out`, which must succeed; at half rate, so that a busy machine decodes some of each step
/// too.
fn main_job(out: &Path, arguments: &[&str]) {
    let output = format!("output:={}", out.display());
    let file = "launch-configs/replay.launch.yaml";
    let mut all = vec!["launch", file, &output, "rate:=0.5"];
    all.extend(arguments);
    let launch = Process::start(wm(fresh_domain(), &all));
    let (status, stdout) = launch.finish(Duration::from_secs(60));
    // Zenoh has no acknowledgements: it drops a sample that no link takes in time. The job must say so.
    let is_counted_loss = over_zenoh() && status.code() == Some(3);
    if is_counted_loss {
        // "lost 2 message(s) of /topic: 2 missing in their publishers' sequence numbers"; any other cause is a fault of ours
        let losses: Vec<&str> = (stdout.lines())
            .filter(|line| line.contains("message(s) of /"))
            .collect();
        let is_of_transport = |line: &&str| {
            let cause = line.split_once(": ").map_or("", |(_, cause)| cause);
            let cause = cause.trim_start_matches(|c: char| c.is_ascii_digit());
            cause == " missing in their publishers' sequence numbers"
        };
        let are_counted = !losses.is_empty() && losses.iter().all(is_of_transport);
        assert!(are_counted, "{stdout}");
        eprintln!("Zenoh dropped samples: {losses:?}");
    }
    assert!(
        status.success() || is_counted_loss,
        "the launch ended with {status}: {stdout}"
    );
    assert!(stdout.contains("PSNR"), "no table in: {stdout}");
}

#[test]
fn four_nodes_of_one_process_do_the_same() {
    let _alone = whole_suite();
    let out = tempfile::tempdir().expect("a temporary directory");
    main_job(out.path(), &["one_process:=true"]);
    let report = std::fs::read(out.path().join("report.json")).expect("report.json is written");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("report.json is JSON");
    for step in report["steps"].as_array().expect("a row per step") {
        assert!(step["n"].as_u64() > Some(0), "{step}");
    }
    // each is a separate node for others
    let bag = BagReader::open(out.path().join("bag")).expect("the recorded bag is read");
    let mut nodes = BTreeSet::new();
    for message in bag.messages() {
        let message = message.expect("a whole message");
        if &*message.topic != "/diagnostics" {
            continue;
        }
        let array: DiagnosticArray = message.decode().expect("a diagnostic array");
        nodes.extend(array.status.into_iter().map(|status| status.name));
    }
    for node in ["encoder", "predictor", "decoder", "planner"] {
        let is_node = |name: &String| name.contains(node);
        assert!(nodes.iter().any(is_node), "{node} is missing: {nodes:?}");
    }
}

/// The stages of a frame in the table of `benches/frame.py`.
fn stages() -> Vec<String> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../benches/frame.py");
    let source = std::fs::read_to_string(source).expect("the benchmark's source");
    let rows = source
        .lines()
        .filter_map(|line| line.strip_prefix("    (\""));
    let names = rows.filter_map(|row| row.split_once('"'));
    names.map(|(name, _)| name.to_owned()).collect()
}

#[test]
fn every_stage_of_a_frame_is_reported_on_request() {
    let _alone = whole_suite();
    let out = tempfile::tempdir().expect("a temporary directory");
    let output = format!("output:={}", out.path().display());
    let arguments = [
        "launch",
        "launch-configs/replay.launch.yaml",
        &output,
        "one_process:=true",
        "log_level:=wm_ros.frame_trace:=debug",
    ];
    let run = wm(fresh_domain(), &arguments).output().expect("wm runs");
    assert!(run.status.success(), "the launch ended with {}", run.status);
    let told = [run.stdout, run.stderr].concat();
    let told = String::from_utf8_lossy(&told);
    let stages = stages();
    assert!(stages.len() > 10, "{stages:?}");
    for stage in stages {
        let count = told.matches(&format!("]: {stage} frame=")).count();
        assert!(count > 0, "{stage}");
    }
    // on /rosout they would distort the times that they report
    let bag = BagReader::open(out.path().join("bag")).expect("the recorded bag is read");
    for message in bag.messages() {
        let message = message.expect("a whole message");
        if &*message.topic == "/rosout" {
            let text = String::from_utf8_lossy(&message.data);
            assert!(!text.contains(" frame="), "{text}");
        }
    }
}

/// The bundled bag with the topic names of another robot.
fn renamed_bag(path: &Path) {
    let reader = BagReader::open(bundled_bag()).expect("the bundled bag");
    let mut writer = BagWriter::create(path, WriterOptions::default()).expect("a new bag");
    let renamed = |name: &str| match name {
        "/camera/image_raw/compressed" => "/front/image_raw/compressed".to_owned(),
        "/wm/action" => "/arm/action".to_owned(),
        other => other.to_owned(),
    };
    for topic in reader.topics() {
        let (name, qos) = (renamed(&topic.name), &topic.qos_yaml);
        let added = writer.add_topic_raw(&name, &topic.type_name, &topic.schema, qos);
        added.expect("a new topic");
    }
    for message in reader.messages() {
        let message = message.expect("a whole message");
        let topic = reader.topic(&message.topic).expect("its topic");
        let (name, time_ns) = (renamed(&message.topic), message.log_time_ns);
        writer
            .write_raw(
                &name,
                &topic.type_name,
                &topic.schema,
                time_ns,
                &message.data,
            )
            .expect("it is written");
    }
    writer.finish().expect("the end of the bag");
}

#[test]
fn bag_with_other_topic_names_is_replayed() {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let (bag, out) = (dir.path().join("robot"), dir.path().join("out"));
    renamed_bag(&bag);
    let bag = format!("bag:={}", bag.display());
    let names = ["camera:=/front/image_raw", "action:=/arm/action"];
    main_job(&out, &[&[bag.as_str()][..], &names].concat());
    let report = std::fs::read(out.join("report.json")).expect("report.json is written");
    let report: serde_json::Value = serde_json::from_slice(&report).expect("report.json is JSON");
    assert!(report["steps"][0]["n"].as_u64() > Some(0), "{report}");
    assert!(report["plans"]["plans"].as_u64() > Some(0), "{report}");
}

#[test]
fn main_job_writes_report_strip_and_bag() {
    let _alone = whole_suite();
    let out = tempfile::tempdir().expect("a temporary directory");
    main_job(out.path(), &[]);

    let report: serde_json::Value = serde_json::from_slice(
        &std::fs::read(out.path().join("report.json")).expect("report.json is written"),
    )
    .expect("report.json is JSON");
    let steps = report["steps"].as_array().expect("a row per step");
    assert_eq!(steps.len(), 8);
    for step in steps {
        assert!(step["n"].as_u64() > Some(0), "{step}");
        assert!(
            step["psnr_db"].as_f64().is_some_and(f64::is_finite),
            "{step}"
        );
    }
    let strip = std::fs::read(out.path().join("strip.png")).expect("strip.png is written");
    assert!(strip.starts_with(b"\x89PNG"));

    // the recorded bag contains the whole job and is itself readable
    let bag = out.path().join("bag");
    let info = Process::start(wm(fresh_domain(), &["bag", "info", &bag.to_string_lossy()]));
    let (status, text) = info.finish(Duration::from_secs(10));
    assert!(status.success());
    for topic in [
        "/wm/latent",
        "/wm/predicted",
        "/wm/predicted/image/compressed",
        "/wm/plan",
        "/camera/image_raw/compressed",
    ] {
        assert!(text.contains(topic), "{topic} was not recorded: {text}");
    }
}

#[test]
fn killed_recorder_loses_at_most_its_last_chunk() {
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let recorded = dir.path().join("recorded");
    let _player = looping_player(domain);
    let recorder = Process::start(wm(
        domain,
        &["bag", "record", "-a", "-o", &recorded.to_string_lossy()],
    ));
    let file = recorded.join("recorded_0.mcap");
    let size = || file.metadata().map_or(0, |metadata| metadata.len());
    wait_until("chunks on the disk", Duration::from_secs(60), || {
        size() > 100_000
    });
    let killed_at = SystemTime::now();
    recorder.signal(Signal::KILL);
    let (status, _) = recorder.finish(Duration::from_secs(10));
    assert!(!status.success());

    let reader = BagReader::open(&recorded).expect("what is left of the bag");
    assert!(reader.message_count() > 0);
    assert!(reader.messages().all(|message| message.is_ok()));
    let end = SystemTime::UNIX_EPOCH + Duration::from_nanos(reader.end_ns());
    let lost = killed_at.duration_since(end).unwrap_or_default();
    // a chunk is closed after a second; a busy machine takes the rest
    assert!(lost < Duration::from_secs(4), "{lost:?} are lost");
}

/// Otherwise the launch would wait for nothing, and a bag may be long.
#[test]
fn end_of_a_computing_node_ends_the_job() {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let output = format!("output:={}", dir.path().display());
    let launch = "launch-configs/replay.launch.yaml";
    let job = Process::start_with_output(wm(
        fresh_domain(),
        &["launch", launch, "loop:=true", &output],
    ));
    let encoder = || {
        let nodes = children(job.pid()).into_iter();
        let named = nodes.filter(|(_, words)| words.iter().any(|word| word == "encoder"));
        named.map(|(pid, _)| pid).next()
    };
    wait_until("the encoder", Duration::from_secs(20), || {
        encoder().is_some()
    });
    let encoder = encoder().expect("it runs");
    rustix::process::kill_process(encoder, Signal::KILL).expect("it runs");
    let (status, said) = job.finish(Duration::from_secs(60));
    assert_eq!(status.code(), Some(1), "{said}");
}

#[test]
fn recording_in_several_files_is_one_bag() {
    let domain = fresh_domain();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let recorded = dir.path().join("recorded");
    let _player = looping_player(domain);
    let options = ["--max-bag-duration", "1", "--compression-format", "lz4"];
    let record = ["bag", "record", "-a", "-o", &recorded.to_string_lossy()];
    let recorder = Process::start(wm(domain, &[&record[..], &options].concat()));
    let third = recorded.join("recorded_2.mcap");
    wait_until("a third file", Duration::from_secs(60), || third.is_file());
    recorder.signal(Signal::INT);
    let (status, stdout) = recorder.finish(Duration::from_secs(10));
    // on a busy machine, best-effort messages may be lost, which is reported
    let expected = if stdout.contains("lost ") { 3 } else { 0 };
    assert_eq!(status.code(), Some(expected), "{stdout}");

    let reader = BagReader::open(&recorded).expect("the bag");
    assert_eq!(reader.warnings(), []);
    let summary = reader.summary();
    assert!(summary.files.len() >= 3, "{summary}");
    assert_eq!(summary.compression, "lz4");
    let times: Vec<u64> = reader
        .messages()
        .map(|message| message.expect("a sound chunk").log_time_ns)
        .collect();
    assert!(times.is_sorted());
    assert_eq!(times.len() as u64, reader.message_count());
}

#[test]
fn dead_node_fails_the_launch_by_name() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let launch = dir.path().join("broken.launch.yaml");
    std::fs::write(
        &launch,
        "launch:\n- node:\n    pkg: wm_nodes\n    exec: encoder\n    name: encoder\n    param:\n    - name: model\n      value: /no/such/model\n",
    )
    .expect("the file is writable");
    let run = wm(fresh_domain(), &["launch", &launch.to_string_lossy()])
        .output()
        .expect("wm runs");
    assert!(!run.status.success());
    let stderr = String::from_utf8_lossy(&run.stderr);
    assert!(
        stderr.contains("encoder") && stderr.contains("/no/such/model"),
        "{stderr}"
    );
}

#[test]
fn invalid_bag_is_refused_by_name() {
    let dir = tempfile::tempdir().expect("a temporary directory");
    let file = dir.path().join("noise.mcap");
    std::fs::write(&file, b"this is not a bag").expect("the file is writable");
    let run = wm(fresh_domain(), &["bag", "play", &file.to_string_lossy()])
        .output()
        .expect("wm runs");
    assert!(!run.status.success());
    assert!(String::from_utf8_lossy(&run.stderr).contains("noise.mcap"));
    assert!(bundled_bag().join("metadata.yaml").is_file());
}
