//! How commands end that cannot do what they were asked.

use std::path::{Path, PathBuf};

use wm_bag::{BagReader, BagWriter, WriterOptions};

use crate::harness::{bundled_bag, fresh_domain, whole_suite, wm};

/// Exit code, standard output and standard error of `wm` with these arguments.
fn run(args: &[&str]) -> (Option<i32>, String, String) {
    let run = wm(fresh_domain(), args).output().expect("wm runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (run.status.code(), text(&run.stdout), text(&run.stderr))
}

#[test]
fn a_replay_of_no_bag_says_so_once_and_leaves_no_report() {
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

#[test]
fn arguments_and_parameters_that_nobody_knows_are_wrong_usage() {
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
fn the_info_of_a_bag_that_was_cut_off_ends_with_3() {
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

/// A copy of a bag in small chunks: its file. The bundled bag is one chunk, of which no part can be recovered.
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
fn a_recovery_and_a_cut_end_with_3_where_something_is_lost() {
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
