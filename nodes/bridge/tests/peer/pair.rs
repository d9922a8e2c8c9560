//! The two bridges.

use crate::harness::{Process, Site, bridge, fresh_domain, fresh_endpoint, in_domain, program};
use std::process::Command;
use wm_msgs::std_msgs::String as Text;
use wm_ros::Subscription;

/// Loopback only, like the nodes. The bridge itself disables multicast there.
const CYCLONE: &str = r#"<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo"/></Interfaces></General>
    </Domain></CycloneDDS>"#;

/// The real bridge of a domain on loopback, connected to an endpoint; `mode`: `router`, its default, or `peer`.
pub fn real_bridge(domain: u16, endpoint: &str, mode: &str) -> Process {
    let config = format!(
        r#"{{ mode: "{mode}", connect: {{ endpoints: ["{endpoint}"] }}, listen: {{ endpoints: [] }},
           scouting: {{ multicast: {{ enabled: false }} }},
           plugins: {{ ros2dds: {{ ros_automatic_discovery_range: "LOCALHOST" }} }} }}"#
    );
    let mut command = Command::new(program("wm-bridge-peer"));
    command
        .arg(config)
        .env("CYCLONEDDS_URI", CYCLONE)
        // selects the format of the graph's messages
        .env("ROS_DISTRO", "kilted");
    in_domain(&mut command, domain);
    Process::start(command)
}

/// A domain with `wm-bridge`, which listens, and one with the real bridge.
pub struct Pair {
    pub here: Site,
    pub there: Site,
    pub domain_here: u16,
    pub domain_there: u16,
    _real_bridge: Process,
    _bridge: Process,
}

impl Pair {
    pub fn new(args: &[&str]) -> Self {
        let (domain_here, domain_there) = (fresh_domain(), fresh_domain());
        let endpoint = fresh_endpoint();
        Self {
            // it has to retry
            _real_bridge: real_bridge(domain_there, &endpoint, "router"),
            _bridge: bridge(domain_here, &[&["--listen", &endpoint], args].concat()),
            here: Site::join(domain_here),
            there: Site::join(domain_there),
            domain_here,
            domain_there,
        }
    }
}

pub async fn next(subscription: &mut Subscription<Text>) -> String {
    let received = crate::harness::soon("a message", subscription.recv()).await;
    received.unwrap().message.data
}
