//! Two hosts with a Zenoh router each: predictions of the one reach a peer on the other that nobody here wrote,
//! zenoh-ros2-sdk of PyPI. Network namespaces are the hosts.

use crate::harness::{Process, WM, fresh_domain, in_domain, peers, root, whole_suite};
use std::{
    io::{BufRead as _, BufReader},
    process::{Command, Stdio},
    time::Duration,
};

const ROBOT: &str = "10.98.0.1";
const DESK: &str = "10.98.0.2";
/// Far longer than anything here takes; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(60);

fn ip(args: &[&str]) -> bool {
    let ran = Command::new("ip").args(args).stderr(Stdio::null()).status();
    ran.is_ok_and(|status| status.success())
}

/// Two network namespaces with a cable between them.
struct Hosts {
    names: [String; 2],
}

impl Hosts {
    /// `None`, with a message, without the necessary rights.
    fn new() -> Option<Self> {
        let names = ["robot", "desk"].map(|end| format!("wm{}{end}", std::process::id()));
        let hosts = Self { names };
        let [robot, desk] = &hosts.names;
        if !(ip(&["netns", "add", robot]) && ip(&["netns", "add", desk])) {
            eprintln!("skipped: the test of two hosts needs `ip netns add`, as root");
            return None;
        }
        let ends = ["wmrobot", "wmdesk"];
        let cable = [
            "link", "add", ends[0], "netns", robot, "type", "veth", "peer",
        ];
        let cable = [&cable[..], &["name", ends[1], "netns", desk]].concat();
        assert!(ip(&cable), "no virtual cable");
        for ((name, device), address) in hosts.names.iter().zip(ends).zip([ROBOT, DESK]) {
            let address = format!("{address}/24");
            for args in [
                &["link", "set", "lo", "up"][..],
                &["addr", "add", &address, "dev", device],
                &["link", "set", device, "up"],
            ] {
                assert!(ip(&[&["-n", name], args].concat()), "{args:?}");
            }
        }
        Some(hosts)
    }

    /// A program on the host of this name, in ROS domain `domain`.
    fn command(&self, host: usize, domain: u16, program: &str, args: &[&str]) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.names[host], program]);
        command.args(args).current_dir(root());
        in_domain(&mut command, domain);
        command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
        command.env("ZENOH_CONFIG_OVERRIDE", NO_SHARED_MEMORY);
        command
    }
}

/// Two hosts share none, but two namespaces of one kernel do.
const NO_SHARED_MEMORY: &str = "transport/shared_memory/enabled=false";

impl Drop for Hosts {
    fn drop(&mut self) {
        for name in &self.names {
            ip(&["netns", "del", name]);
        }
    }
}

#[test]
fn predictions_reach_a_peer_on_another_host() {
    let _alone = whole_suite();
    let Some(peers) = peers() else { return };
    let Some(hosts) = Hosts::new() else { return };
    let (domain, out) = (fresh_domain(), tempfile::tempdir().unwrap());
    let wm = |host, args: &[&str]| Process::start(hosts.command(host, domain, WM, args));
    let _robots = wm(0, &["zenoh-router", "--listen", "tcp/0.0.0.0:7447"]);
    let connect = format!("tcp/{ROBOT}:7447");
    let _desks = wm(1, &["zenoh-router", "--connect", &connect]);
    let output = format!("output:={}", out.path().join("job").display());
    let file = "launch-configs/replay.launch.yaml";
    let _job = wm(0, &["launch", file, "loop:=true", &output]);

    let python = peers.join("tools/bin/python");
    let sdk = root().join("nodes/bridge/tests/peer/sdk.py");
    let args = [
        &sdk.to_string_lossy(),
        "tcp/127.0.0.1:7447",
        "echo",
        "/wm/summary",
    ];
    let mut echo = hosts.command(1, domain, &python.to_string_lossy(), &args);
    // the SDK takes the router's address as an argument
    echo.env_remove("ZENOH_CONFIG_OVERRIDE")
        .env_remove("LD_LIBRARY_PATH");
    let mut echo = echo
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(echo.stdout.take().unwrap()).lines();
    let (sender, received) = std::sync::mpsc::channel();
    let reader = std::thread::spawn(move || {
        lines
            .map_while(Result::ok)
            .for_each(|line| drop(sender.send(line)));
    });
    let mut predictions = 0;
    while predictions < 5 {
        let line = received
            .recv_timeout(PATIENCE)
            .expect("the desk hears summaries");
        predictions += usize::from(line.ends_with("k = 1 to"));
    }
    drop(echo.stdin.take());
    echo.wait().unwrap();
    reader.join().unwrap();
}
