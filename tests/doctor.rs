//! `wm doctor` and `wm init` with a camera and an arm that are played from the bundled bag.

use std::time::Duration;

use serde_json::Value;

use crate::harness::{Process, fresh_domain, whole_suite, wm};

/// Exit code, standard output and standard error.
fn run(domain: u16, args: &[&str]) -> (Option<i32>, String, String) {
    let run = wm(domain, args).output().expect("wm runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (run.status.code(), text(&run.stdout), text(&run.stderr))
}

/// A camera and an arm, until it is dropped.
fn robot(domain: u16) -> Process {
    let play = ["bag", "play", "bags/tabletop", "--loop", "--restamp"];
    Process::start(wm(domain, &play))
}

/// The findings of one check.
fn of<'a>(report: &'a Value, check: &str) -> Vec<&'a Value> {
    let findings = report["findings"].as_array().expect("findings");
    findings
        .iter()
        .filter(|finding| finding["check"] == check)
        .collect()
}

#[test]
fn working_robot_has_no_error() {
    let _alone = whole_suite();
    let domain = fresh_domain();
    let robot = robot(domain);
    let (code, stdout, stderr) = run(domain, &["doctor", "--json", "--seconds", "8"]);
    let report: Value =
        serde_json::from_str(&stdout).unwrap_or_else(|error| panic!("{error}: {stdout}{stderr}"));
    assert_eq!(code, Some(0), "{report:#}");
    let camera = &report["cameras"][0];
    assert_eq!(camera["camera"], "/camera/image_raw", "{report:#}");
    let rates = camera["topics"]
        .as_array()
        .expect("topics")
        .iter()
        .filter_map(|topic| topic["rate_hz"].as_f64());
    // the bag's stamps are exactly 0.2 s apart, also when shifted
    assert!(
        rates.into_iter().any(|rate| (rate - 5.0).abs() < 0.05),
        "{report:#}"
    );
    assert!(
        camera["mean"].as_f64().is_some_and(|mean| mean > 0.1),
        "{report:#}"
    );
    assert_eq!(report["actions"][0]["topic"], "/wm/action", "{report:#}");
    // the bundled model knows the simulator's pictures
    let known = of(&report, "model").into_iter().find(|finding| {
        finding["what"]
            .as_str()
            .is_some_and(|what| what.contains("far from the training's"))
    });
    assert_eq!(known.expect("pictures were compared")["level"], "ok");
    drop(robot);
}

#[test]
fn every_finding_suggests_a_fix_in_a_silent_domain() {
    let _alone = whole_suite();
    let (code, stdout, stderr) = run(fresh_domain(), &["doctor", "--seconds", "1", "--json"]);
    assert_eq!(code, Some(1), "{stderr}");
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(of(&report, "camera")[0]["level"], "error");
    for finding in report["findings"].as_array().expect("findings") {
        let is_bad = finding["level"] == "warning" || finding["level"] == "error";
        assert!(!is_bad || finding["fix"].is_string(), "{finding}");
    }
    let (code, stdout, _) = run(
        fresh_domain(),
        &["doctor", "--seconds", "1", "--model", "/no/model"],
    );
    assert_eq!(code, Some(1));
    assert!(
        stdout.contains("ERROR    model") && stdout.contains("/no/model"),
        "{stdout}"
    );
}

#[test]
fn wrong_usage_differs_from_a_finding() {
    let usage = [
        &["doctor", "--interface", "nope0"][..],
        &["doctor", "--seconds", "0"],
        &["init"],
    ];
    for args in usage {
        let (code, stdout, stderr) = run(fresh_domain(), args);
        assert_eq!((code, stdout.as_str()), (Some(2), ""), "{args:?}: {stderr}");
    }
}

#[test]
fn init_writes_a_launch_for_the_topics_found() {
    let _alone = whole_suite();
    let domain = fresh_domain();
    let out = tempfile::tempdir().expect("a temporary directory");
    let folder = out.path().join("robot");
    let folder = folder.to_str().expect("UTF-8");
    let (code, _, stderr) = run(domain, &["init", folder, "--seconds", "1"]);
    assert_eq!(code, Some(1), "{stderr}");
    assert!(stderr.contains("no camera was found"), "{stderr}");

    let robot = robot(domain);
    let (code, stdout, stderr) = run(domain, &["init", folder, "--seconds", "8"]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stdout.contains("camera /camera/image_raw, actions /wm/action, model tiny"),
        "{stdout}"
    );
    let file = format!("{folder}/live.launch.yaml");
    let (code, plan, stderr) = run(domain, &["launch", "--print-description", &file]);
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        plan.contains(&format!("{folder}/config/encoder.yaml")),
        "{plan}"
    );
    let (code, _, stderr) = run(
        domain,
        &[
            "init",
            folder,
            "--seconds",
            "1",
            "--camera",
            "/camera/image_raw",
        ],
    );
    assert_eq!(code, Some(1), "{stderr}");
    assert!(
        stderr.contains("exists already, and nothing was written"),
        "{stderr}"
    );
    drop(robot);

    // the launch file works: the encoder becomes active
    let robot = self::robot(domain);
    let output = format!("output:={}", out.path().join("live").display());
    let launch = Process::start(wm(domain, &["launch", &file, &output]));
    let (code, stdout, _) = run(domain, &["doctor", "--json", "--seconds", "10"]);
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(code, Some(0), "{report:#}");
    assert!(report["participants"].as_u64() > Some(3), "{report:#}");
    launch.signal(crate::harness::Signal::INT);
    let (status, _) = launch.finish(Duration::from_secs(30));
    assert!(status.success(), "{status}");
    drop(robot);
}
