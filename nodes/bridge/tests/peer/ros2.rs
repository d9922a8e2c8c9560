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

async fn collect(peers: &Path, domain: u16, args: &[&str]) -> String {
    let collector = Python::start(peers, domain, "tests/interop/collect.py", args);
    let collected = tokio::task::spawn_blocking(move || collector.output());
    soon("the end of collect.py", collected).await.unwrap()
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
    // A participant of Fast DDS sometimes never discovers all of Cyclone's on a busy machine. The bridges keep running, so
    // what they lose stays lost for the second one too.
    let args = ["--seconds", "25", wanted];
    let collect = || collect(&peers, there, &args);
    let mut collected = collect().await;
    if !collected.contains("\"from here\"") {
        eprintln!("no message at the first rclpy: {collected}");
        collected = collect().await;
    }
    assert!(collected.contains("\"from here\""), "{collected}");
    // not beside the first program: of two that started at once, one was sometimes never discovered
    let say = "nodes/bridge/tests/peer/say.py";
    let _speaker = Python::start(&peers, there, say, &["/wm/said", "from there"]);
    let mut heard = here.subscription::<Text>("said", latched).unwrap();
    assert_eq!(next(&mut heard).await, "from there");
}
