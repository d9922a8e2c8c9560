//! A real ROS 2 behind the real bridge: rclpy on Fast DDS, which announces the types' hashes, unlike our nodes.

use crate::{
    harness::{in_domain, root, soon, text},
    pair::{Pair, next},
    ros2_peer::{peers, ros2_env},
};
use std::{
    path::Path,
    process::{Child, Command, Stdio},
};
use wm_msgs::std_msgs::String as Text;
use wm_ros::Qos;

/// A Python program that ends with the test.
struct Python(Child);

impl Python {
    fn start(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Self {
        let mut command = Command::new("bash");
        command
            .args(["-c", ". \"$0\" && exec python \"$@\""])
            .arg(ros2_env(peers))
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
    let Some(peers) = peers() else { return };
    let pair = Pair::new(&[]);
    let (here, there) = (&pair.here.node, pair.domain_there);
    let latched = Qos::latched(1);
    let map = here.publisher::<Text>("map", latched).unwrap();
    map.publish(&text("from here")).unwrap();
    let wanted = "/wm/map:std_msgs/msg/String:1:latched";
    let collect = ["--seconds", "50", wanted];
    let collector = Python::start(&peers, there, "tests/interop/collect.py", &collect);
    let collected = tokio::task::spawn_blocking(move || collector.output());
    let collected = soon("the message at rclpy", collected).await.unwrap();
    assert!(collected.contains("\"from here\""), "{collected}");
    // not beside the first program: of two that started at once, one was sometimes never discovered
    let say = "nodes/bridge/tests/peer/say.py";
    let _speaker = Python::start(&peers, there, say, &["/wm/said", "from there"]);
    let mut heard = here.subscription::<Text>("said", latched).unwrap();
    assert_eq!(next(&mut heard).await, "from there");
}
