//! A model of two cameras on real episodes (DROID): imported, trained for two steps, and replayed live. The data are in the
//! folder of the environment variable WM_SHARED_DATA, and no part of the repository.

use std::{path::Path, time::Duration};

use wm_bag::BagReader;
use wm_camera::camera_frame::CameraFrame;
use wm_msgs::wm_msgs::Prediction;

use crate::harness::{Process, fresh_domain, whole_suite, wm};

#[path = "../learning/import/tests/shared_data/folder.rs"]
mod folder;

const CAMERAS: [&str; 2] = ["/exterior_1/image_raw", "/wrist/image_raw"];

/// Runs `wm` to its end; `None` if the program behind the command is not built.
fn run(args: &[&str]) -> Option<()> {
    let help = wm(fresh_domain(), &[args[0], args[1], "--help"]).output();
    if !help.expect("wm runs").status.success() {
        eprintln!("skipped: wm {} {} is not built", args[0], args[1]);
        return None;
    }
    let ended = wm(fresh_domain(), args).output().expect("wm runs");
    let log = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "wm {}: {log}", args.join(" "));
    Some(())
}

/// A model of two cameras in `folder`, and a bag with both.
fn trained(folder: &Path) -> Option<(String, String)> {
    let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let source = folder::shared("droid")?;
    let (bags, model) = (path("bags"), path("model"));
    let source = source.to_string_lossy();
    // Two short episodes.
    run(&["bag", "import", "droid", &source, &bags, "--shard", "5/9"])?;
    let cameras = CAMERAS.iter().flat_map(|camera| ["--camera", *camera]);
    let mut args = vec!["train", "transition", "--data", &bags, "--out", &model];
    args.extend(cameras);
    args.extend(["--encoder", "tiny", "--from", "tiny"]);
    args.extend(["--steps", "2", "--validation", "0"]);
    run(&args)?;
    // Its camera has the nodes' default rate, 5 Hz.
    Some((model, path("bags/episode_000014")))
}

#[test]
fn two_view_model_runs_live_on_real_episodes() {
    let _alone = whole_suite();
    let dir = tempfile::tempdir().expect("a temporary directory");
    let Some((model, bag)) = trained(dir.path()) else {
        return;
    };
    let out = dir.path().join("out");
    let arguments = [
        "launch",
        "launch-configs/replay.launch.yaml",
        &format!("bag:={bag}"),
        &format!("cameras:=[{}]", CAMERAS.join(", ")),
        &format!("model:={model}"),
        &format!("output:={}", out.display()),
    ];
    let launch = Process::start(wm(fresh_domain(), &arguments));
    let (status, stdout) = launch.finish(Duration::from_secs(60));
    assert!(status.success(), "the launch ended with {status}: {stdout}");

    let recorded = BagReader::open(out.join("bag")).expect("the recorded bag");
    let count = |topic: &str| recorded.topic(topic).map_or(0, |topic| topic.message_count);
    let frames = BagReader::open(&bag).expect("the played bag");
    let frames = frames
        .topic("/wm/action")
        .expect("its actions")
        .message_count;
    // Some may come before all nodes have met.
    let joined = count("/wm/views/image_raw");
    assert!(
        joined <= frames && joined + 5 >= frames,
        "{joined} of {frames}"
    );
    for message in recorded.messages().only_topics(["/wm/views/image_raw"]) {
        let frame = CameraFrame::of_bag(&message.expect("a message")).expect("a picture");
        assert_eq!(frame.size(), Some((128, 128)));
        assert_eq!(frame.header().frame_id, "exterior_1_optical_frame");
    }
    let mut predictions = recorded.messages().only_topics(["/wm/predicted"]);
    let prediction = predictions.next().expect("predictions").expect("a message");
    let prediction: Prediction = prediction.decode().expect("a prediction");
    assert!(prediction.observed_stamp.sec > 0, "{prediction:?}");
    assert!(count("/wm/predicted/image/compressed") > 0);
}
