//! A real ROS 2 behind the real bridge: rclpy on Fast DDS, which announces the types' hashes, unlike our nodes.

use crate::{
    harness::{in_domain, root, soon, text},
    pair::{Pair, next},
};
use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};
use wm_msgs::std_msgs::String as Text;
use wm_ros::Qos;

/// The setup script of the real ROS 2; `None` (with a message) without `tests/setup_ros2`.
fn ros2() -> Option<PathBuf> {
    let environment = root().join(".venv/ros2/ros2_env.sh");
    if environment.is_file() {
        return Some(environment);
    }
    eprintln!("skipped: no ROS 2 under .venv; run tests/setup_ros2 (tests/run does)");
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// A Python program that ends with the test.
struct Python(Child);

impl Python {
    fn start(environment: &Path, domain: u16, script: &str, args: &[&str]) -> Self {
        let mut command = Command::new("bash");
        command
            .args(["-c", ". \"$0\" && exec python \"$@\""])
            .arg(environment)
            .arg(root().join(script))
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        in_domain(&mut command, domain);
        Self(command.spawn().unwrap())
    }

    fn output(mut self) -> String {
        let output = self.0.stdout.take().unwrap();
        std::io::read_to_string(output).unwrap()
    }
}

impl Drop for Python {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn real_ros_2_communicates_through_the_real_bridge() {
    let Some(ros2) = ros2() else { return };
    let pair = Pair::new(&[]);
    let (here, there) = (&pair.here.node, pair.domain_there);
    let latched = Qos::latched(1);
    let map = here.publisher::<Text>("map", latched).unwrap();
    map.publish(&text("from here")).unwrap();
    let wanted = "/wm/map:std_msgs/msg/String:1:latched";
    let collect = ["--seconds", "60", wanted];
    let collector = Python::start(&ros2, there, "tests/interop/collect.py", &collect);
    let say = "nodes/bridge/tests/peer/say.py";
    let _speaker = Python::start(&ros2, there, say, &["/wm/said", "from there"]);
    let mut heard = here.subscription::<Text>("said", latched).unwrap();
    assert_eq!(next(&mut heard).await, "from there");
    let collected = tokio::task::spawn_blocking(move || collector.output());
    let collected = soon("the message at rclpy", collected).await.unwrap();
    assert!(collected.contains("\"from here\""), "{collected}");
}
