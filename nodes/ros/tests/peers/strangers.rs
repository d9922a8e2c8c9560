//! Strangers on the network: a node that is to be heard on this host only, or by named hosts only, is not found by others.
//!
//! The node and the stranger are in network namespaces of their own, with an Ethernet between them.

use super::{
    announcement::announcement,
    harness::{Process, fresh_domain, given, node, peers, role, root},
    network::{FIRST as NODE, Network, SECOND as STRANGER, run},
};
use std::{
    net::UdpSocket,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};
use wm_msgs::std_msgs;
use wm_ros::{Context, Environment, Middleware, Qos, Reach};

/// A vendor of DDS.
const SOMEBODY: u8 = 0x10;
/// Longer than discovery takes.
const SEARCH: &str = "8";

impl Network {
    /// A node on the first host at `reach`, and what a stranger finds of it and the node hears of the stranger.
    fn meet(&self, peers: &Path, domain: u16, reach: &str) -> (String, usize) {
        let inside = ["ip", "netns", "exec", &self.first];
        let node = Process::start(role(&inside, "strangers::listener", domain, reach));
        node.says("it runs");
        let mut stranger = Command::new("ip");
        stranger
            .args(["netns", "exec", &self.second])
            .arg(peers.join("tools/bin/python"))
            .arg(root().join("tests/interop/stranger.py"))
            .args([STRANGER, NODE, SEARCH])
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env_remove("LD_LIBRARY_PATH");
        let found = Process::start(stranger).says("others");
        let heard = node.last_line().map_or(0, |line| line.parse().unwrap());
        (found, heard)
    }
}

/// Says how many messages have come, until it is killed.
#[test]
#[ignore = "started by the tests of this module"]
fn listener() {
    let (domain_id, address) = given();
    let reach = match address.as_str() {
        "" => Reach::Localhost,
        address => Reach::Interfaces(vec![address.parse().unwrap()]),
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let context = Context::new(&Environment {
            domain_id,
            reach,
            middleware: Middleware::Dds,
        })
        .unwrap();
        let node = node(&context, "listener", "");
        let mut told = node
            .subscription::<std_msgs::String>("/wm/told", Qos::reliable(10))
            .unwrap();
        println!("it runs");
        let mut came = 0;
        while told.recv().await.is_some() {
            came += 1;
            println!("{came}");
        }
    });
}

/// Announces a participant that does not exist to every participant of the domain at [`NODE`], and says how many
/// datagrams come back.
#[test]
#[ignore = "started by the test of this module"]
fn forger() {
    let (domain, _) = given();
    let socket = UdpSocket::bind((STRANGER, 0)).unwrap();
    let port = socket.local_addr().unwrap().port();
    let message = announcement(SOMEBODY, STRANGER.parse().unwrap(), port);
    for participant in 0..12 {
        let to = 7400 + 250 * domain + 10 + 2 * participant;
        socket.send_to(&message, (NODE, to)).unwrap();
    }
    socket
        .set_read_timeout(Some(Duration::from_secs(5)))
        .unwrap();
    let (start, mut came, mut buffer) = (Instant::now(), 0, [0; 1 << 16]);
    while start.elapsed() < Duration::from_secs(5) && socket.recv(&mut buffer).is_ok() {
        came += 1;
    }
    println!("came: {came}");
}

#[test]
fn a_forged_announcement_from_the_network_brings_nothing_back() {
    let Some(network) = Network::new() else {
        return;
    };
    let domain = fresh_domain();
    let answers = |reach| -> usize {
        let inside = ["ip", "netns", "exec", &network.first];
        let node = Process::start(role(&inside, "strangers::listener", domain, reach));
        node.says("it runs");
        let inside = ["ip", "netns", "exec", &network.second];
        let forger = Process::start(role(&inside, "strangers::forger", domain, ""));
        let line = forger.says("came: ");
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    assert!(answers(NODE) > 0, "where the network is asked for");
    assert_eq!(answers(""), 0, "on loopback");
}

const FOUND: &str = r#""connected": true"#;
const NOT_FOUND: &str = r#"{"others": 0, "connected": false}"#;

#[test]
fn loopback_node_and_network_do_not_reach_each_other() {
    let Some(peers) = peers() else { return };
    let Some(network) = Network::new() else {
        return;
    };
    let domain = fresh_domain();
    // where the network is asked for, the two meet
    let (found, heard) = network.meet(&peers, domain, NODE);
    assert!(found.contains(FOUND) && heard > 0, "{found} {heard}");
    let (found, heard) = network.meet(&peers, domain, "");
    assert_eq!((found.as_str(), heard), (NOT_FOUND, 0));
}

#[test]
fn the_firewall_that_is_shipped_lets_in_only_who_is_named() {
    let Some(peers) = peers() else { return };
    let Some(network) = Network::new() else {
        return;
    };
    if let Err(reason) = run("nft --version") {
        eprintln!("skipped: no nftables here (tests/setup_system installs it): {reason}");
        return;
    }
    let domain = fresh_domain();
    let shipped = root().join("launch-configs/network/wm.nft");
    let shipped = std::fs::read_to_string(shipped).unwrap();
    let first = 7400 + 250 * domain;
    let ports = format!("{first}-{}", first + 249);
    let folder = tempfile::tempdir().unwrap();
    let rules = folder.path().join("rules.nft");
    let load = |trusted: &str| {
        let text = shipped
            .replace("192.168.1.10, 192.168.1.11", trusted)
            .replace("7400-7649", &ports);
        assert!(text.contains(trusted) && text.contains(&ports));
        std::fs::write(&rules, text).unwrap();
        let load = format!("ip netns exec {} nft -f {}", network.first, rules.display());
        run(&load).unwrap_or_else(|reason| panic!("{load}: {reason}"));
    };
    load("10.213.7.77");
    let (found, heard) = network.meet(&peers, domain, NODE);
    assert_eq!(heard, 0, "{found}");
    assert!(!found.contains(FOUND), "{found}");
    // loaded anew, it replaces what it was
    load(STRANGER);
    let (found, heard) = network.meet(&peers, domain, NODE);
    assert!(found.contains(FOUND) && heard > 0, "{found} {heard}");
}

#[test]
fn the_systemd_unit_that_is_shipped_is_valid() {
    let unit = root().join("launch-configs/network/wm.service");
    let text = std::fs::read_to_string(&unit).unwrap();
    for line in [
        "IPAddressDeny=any",
        "IPAddressAllow=localhost",
        "MemoryMax=4G",
    ] {
        assert!(text.lines().any(|known| known == line), "{line}");
    }
    let verify = Command::new("systemd-analyze")
        .arg("verify")
        .arg(&unit)
        .output();
    let Ok(output) = verify else {
        eprintln!("skipped: no systemd here");
        return;
    };
    let said = String::from_utf8_lossy(&output.stderr);
    let said = said.lines().filter(|line| line.contains("wm.service"));
    // that the program is not installed here is no fault of the unit
    let faults: Vec<&str> = said.filter(|line| !line.contains("/usr/bin/wm")).collect();
    assert!(faults.is_empty(), "{faults:?}");
}
