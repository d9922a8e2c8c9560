//! A wall clock that is set back under a running node.

use super::harness::{Process, fresh_domain, given, role};
use std::path::Path;
use wm_ros::{Error, Node, NodeArgs};

/// Where Debian's `faketime` has it.
const LIBRARIES: [&str; 2] = [
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
];

/// A node that waits to be ended, and says why it was.
#[test]
#[ignore = "started by the test of this module"]
fn waiting_node() {
    given();
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    let ended = wm_ros::run("waiting", "/wm", &args, async |node: Node| {
        node.seal_parameters()?;
        println!("it runs");
        node.shutdown().wait().await;
        Ok::<(), Error>(())
    });
    println!("ended: {}", ended.unwrap_err());
}

#[test]
fn a_clock_that_is_set_back_ends_the_node_with_an_error() {
    let Some(library) = LIBRARIES.iter().find(|path| Path::new(path).exists()) else {
        eprintln!(
            "skipped: no libfaketime; install the package faketime (tests/setup_system does)"
        );
        assert!(std::env::var_os("CI").is_none(), "not to be skipped in CI");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let offset = folder.path().join("offset");
    std::fs::write(&offset, "+0").unwrap();
    let mut command = role(&[], "clock::waiting_node", fresh_domain(), "");
    command
        .env("LD_PRELOAD", library)
        .env("FAKETIME_TIMESTAMP_FILE", &offset)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let node = Process::start(command);
    node.says("it runs");
    // two beats of the node's own watch go by in peace
    std::thread::sleep(std::time::Duration::from_millis(2500));
    std::fs::write(&offset, "-30").unwrap();
    let reason = node.says("ended: ");
    assert!(reason.contains("clock was set back by 30"), "{reason}");
    assert!(node.finish().success());
}
