//! How commands end that cannot do what they were asked.

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
