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

/// Whether this run tests over Zenoh.
pub fn over_zenoh() -> bool {
    std::env::var("RMW_IMPLEMENTATION").is_ok_and(|name| name.contains("zenoh"))
}

/// The ROS 2 distribution of the peers: `WM_TEST_ROS_DISTRO`, else Kilted.
pub fn distribution() -> String {
    std::env::var("WM_TEST_ROS_DISTRO").unwrap_or_else(|_| "kilted".to_owned())
}

/// The virtual environments of `tests/setup_ros2`; `None`, with a message, if it was not run.
pub fn peers() -> Option<PathBuf> {
    if over_zenoh() {
        eprintln!("skipped: the peers under .venv use DDS");
        return None;
    }
    let dir = root().join(".venv");
    let ros2 = ros2(&dir);
    if [&ros2, &dir.join("tools")]
        .iter()
        .all(|environment| environment.join("stamp").is_file())
    {
        return Some(dir);
    }
    eprintln!(
        "skipped: no ROS 2 peer in {}; run tests/setup_ros2 (tests/run does)",
        ros2.display()
    );
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// The real ROS 2 of [`peers`].
fn ros2(peers: &Path) -> PathBuf {
    peers.join(format!("ros2-{}", distribution()))
}

/// The file that a shell sources for the real ROS 2 of [`peers`].
pub fn ros2_env(peers: &Path) -> PathBuf {
    ros2(peers).join("ros2_env.sh")
}

/// A Python program under `tests/interop`, with the real ROS 2 of [`peers`].
pub fn rclpy(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Command {
    let mut command = Command::new("bash");
    command
        .args(["-c", ". \"$0\" && exec python \"$@\""])
        .arg(ros2_env(peers))
        .arg(root().join("tests/interop").join(script))
        .args(args);
    in_domain(&mut command, domain);
    command
}
