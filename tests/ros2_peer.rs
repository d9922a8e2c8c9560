//! The real ROS 2 under `.venv`, as a peer of the programs under test.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// The root of the repository: two folders above every crate with such tests.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Sets the ROS domain of `command`, on loopback.
pub fn in_domain(command: &mut Command, domain: u16) {
    command
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env_remove("ROS_LOCALHOST_ONLY")
        .env_remove("ROS_STATIC_PEERS");
}

/// The virtual environments of `tests/setup_ros2`; `None`, with a message, if it was not run.
pub fn peers() -> Option<PathBuf> {
    let dir = root().join(".venv");
    if dir.join("stamp").is_file() {
        return Some(dir);
    }
    eprintln!("skipped: no ROS 2 peer under .venv; run tests/setup_ros2 (tests/run does)");
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// A Python program under `tests/interop`, with the real ROS 2 of [`peers`].
pub fn rclpy(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Command {
    let mut command = Command::new("bash");
    command
        .args(["-c", ". \"$0\" && exec python \"$@\""])
        .arg(peers.join("ros2/ros2_env.sh"))
        .arg(root().join("tests/interop").join(script))
        .args(args);
    in_domain(&mut command, domain);
    command
}
