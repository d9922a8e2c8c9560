//! The main job: one command replays the bundled bag through the nodes and leaves a report.

use std::time::Duration;

use crate::harness::{Process, bundled_bag, fresh_domain, wm};

#[test]
fn the_main_job_leaves_report_strip_and_bag() {
    let out = tempfile::tempdir().expect("a temporary directory");
    let launch = Process::start(wm(
        fresh_domain(),
        &[
            "launch",
            "launch-configs/replay.launch.yaml",
            &format!("output:={}", out.path().display()),
        ],
    ));
    let (status, stdout) = launch.finish(Duration::from_secs(60));
    assert!(status.success(), "the launch ended with {status}");
    assert!(stdout.contains("PSNR"), "no table in: {stdout}");

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

    // The recorded bag holds the whole job and is itself a bag that can be read.
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
fn a_node_that_dies_fails_the_launch_by_name() {
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
fn a_bag_that_is_no_bag_is_refused_by_name() {
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
