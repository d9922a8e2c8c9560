//! Answers to calls that are larger than a datagram of Ethernet.

use super::harness::{PATIENCE, Process, context, fresh_domain, node, peers, rclpy, soon};
use wm_ros::Descriptor;

/// What `ros2 param dump` and `ros2 lifecycle list -a` ask for: every parameter with its description.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_real_ros_2_client_gets_large_answers_and_those_behind_them() {
    const NUMBER: usize = 150;
    let Some(peers) = peers() else { return };
    let domain = fresh_domain();
    let here = context(domain);
    let node = node(&here, "talkative", "");
    let description =
        "A parameter with a description of the usual length, so that many do not fit. ".repeat(3);
    let _parameters: Vec<_> = (0..NUMBER)
        .map(|index| {
            let name = format!("parameter_{index:03}");
            node.declare(&name, 1_i64, Descriptor::new(&description))
                .unwrap()
        })
        .collect();
    node.seal_parameters().unwrap();

    let seconds = PATIENCE.as_secs().to_string();
    let arguments = [
        "--seconds",
        &seconds,
        "/wm/talkative",
        "--set",
        "parameter_007=1",
    ];
    // two clients of one service, each of which gets the other's answers too
    let clients = [(); 2].map(|()| {
        let command = rclpy(&peers, domain, "parameters.py", &arguments);
        tokio::task::spawn_blocking(move || Process::start(command).says("parameters"))
    });
    for client in clients {
        let report = soon("an answer", client).await.unwrap();
        for index in 0..NUMBER {
            assert!(report.contains(&format!("parameter_{index:03}")), "{index}");
        }
        // 35 kB, and then a small one
        assert!(report.contains(&description) && report.contains("\"sets\""));
    }
}
