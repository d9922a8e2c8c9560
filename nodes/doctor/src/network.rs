//! The ROS domain and the network interfaces.

use crate::{DoctorError, Finding, system_file::read};
use std::collections::{BTreeMap, BTreeSet};
use wm_ros::{Environment, EnvironmentWarning, Interface, Middleware, Reach};

const CHECK: &str = "network";
/// The ports of RTPS: 7400 plus 250 per domain; from the tenth on, each participant of a domain has two.
const FIRST_PORT: u16 = 7400;
const PORTS_OF_DOMAIN: u16 = 250;
const FIRST_PARTICIPANT: u16 = 10;
/// Linux gives the ports of higher domains to any program.
const HIGHEST_DOMAIN: u16 = 100;

/// The domain and interfaces of this process.
#[derive(Clone, Debug)]
pub(crate) struct Network {
    /// `ROS_DOMAIN_ID`.
    pub domain: u16,
    pub reach: Reach,
    pub middleware: Middleware,
    pub interfaces: Vec<Interface>,
    /// Listening participants of this host, by domain.
    pub listeners: BTreeMap<u16, usize>,
    /// Environment variables that the nodes cannot obey.
    pub warnings: Vec<EnvironmentWarning>,
}

impl Network {
    pub(crate) fn look(environment: &Environment) -> Result<Self, DoctorError> {
        Ok(Self {
            domain: environment.domain_id,
            reach: environment.reach.clone(),
            middleware: environment.middleware,
            interfaces: Interface::all()?,
            listeners: listeners_of(&read("/proc/net/udp")?),
            warnings: Environment::warnings()?,
        })
    }

    /// Interfaces other than loopback.
    fn outer(&self) -> Vec<&Interface> {
        let is_outer = |interface: &&Interface| !interface.address.is_loopback();
        self.interfaces.iter().filter(is_outer).collect()
    }
}

/// Participants by domain, from the ports in `/proc/net/udp`.
fn listeners_of(text: &str) -> BTreeMap<u16, usize> {
    let ports: BTreeSet<u16> = text.lines().skip(1).filter_map(port_of).collect();
    let mut listeners = BTreeMap::new();
    for port in ports {
        let Some(offset) = port.checked_sub(FIRST_PORT) else {
            continue;
        };
        let (domain, within) = (offset / PORTS_OF_DOMAIN, offset % PORTS_OF_DOMAIN);
        let is_discovery = within >= FIRST_PARTICIPANT && within.is_multiple_of(2);
        if domain <= HIGHEST_DOMAIN && is_discovery {
            *listeners.entry(domain).or_default() += 1;
        }
    }
    listeners
}

/// The local port of a line, for example `  12: 00000000:1CF2 00000000:0000 07 ...`.
fn port_of(line: &str) -> Option<u16> {
    let local = line.split_whitespace().nth(1)?;
    u16::from_str_radix(local.split_once(':')?.1, 16).ok()
}

fn listed(interfaces: &[&Interface]) -> String {
    let names = interfaces
        .iter()
        .map(|found| format!("{} ({})", found.name, found.address));
    names.collect::<Vec<_>>().join(", ")
}

/// `is_silent`: no other participant was found.
pub(crate) fn check(network: &Network, is_silent: bool) -> Vec<Finding> {
    let domain = network.domain;
    let outer = network.outer();
    let mut findings = vec![match &network.reach {
        Reach::Localhost | Reach::Interfaces(_) | Reach::Subnet
            if network.middleware == Middleware::Zenoh =>
        {
            Finding::note(CHECK, format!("domain {domain}, over Zenoh"))
                .because("nodes are discovered through the router of this host, and other hosts through theirs")
        }
        Reach::Localhost => Finding::note(CHECK, format!("domain {domain}, this host only"))
            .because("nodes of other machines are not reached, which is the safe default")
            .fix(match outer.as_slice() {
                [] => "not needed: this host has no other interface".to_owned(),
                [first, ..] => format!(
                    "if camera or arm are on another machine: --interface {} on every node (of {})",
                    first.name,
                    listed(&outer)
                ),
            }),
        Reach::Interfaces(addresses) => {
            let addresses: Vec<_> = addresses.iter().map(ToString::to_string).collect();
            Finding::ok(CHECK, format!("domain {domain}, on {}", addresses.join(", ")))
        }
        Reach::Subnet if outer.len() > 1 => {
            Finding::warning(CHECK, format!("domain {domain}, on every interface: {}", listed(&outer)))
                .because("hosts that are reachable over two interfaces receive every message twice, and large ones stall")
                .fix(format!("--interface {} on every node, or another of these", outer.first().map_or("eth0", |found| &found.name)))
        }
        Reach::Subnet => Finding::ok(CHECK, format!("domain {domain}, on every interface")),
        Reach::Process => Finding::warning(CHECK, "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF")
            .because("only nodes of one process discover each other; no camera is received")
            .fix("unset ROS_AUTOMATIC_DISCOVERY_RANGE"),
    }];
    let warnings = network.warnings.iter();
    findings.extend(warnings.map(|EnvironmentWarning { problem, fix }| {
        Finding::warning(CHECK, problem.clone()).fix(fix.clone())
    }));
    let others: Vec<_> = network
        .listeners
        .iter()
        .filter(|(other, _)| **other != domain)
        .collect();
    // The ports are those of DDS.
    if is_silent && !others.is_empty() && network.middleware == Middleware::Dds {
        let domains: Vec<_> = others
            .iter()
            .map(|(other, count)| format!("{other} ({count})"))
            .collect();
        findings.push(
            Finding::warning(CHECK, format!("nobody else in domain {domain}, but participants of this host listen in others: {}", domains.join(", ")))
                .because("nodes discover each other only within one domain")
                .fix(format!("if your drivers are there: export ROS_DOMAIN_ID={}", others.first().map_or(0, |(other, _)| **other))),
        );
    } else if is_silent && network.reach != Reach::Process {
        let (name, fix) = match network.middleware {
            Middleware::Dds => (
                "DDS",
                "start the drivers in this domain (echo $ROS_DOMAIN_ID), on this host or with --interface; if they use \
                 rmw_zenoh_cpp: export RMW_IMPLEMENTATION=rmw_zenoh_cpp",
            ),
            Middleware::Zenoh => (
                "Zenoh",
                "start the drivers in this domain (echo $ROS_DOMAIN_ID) with RMW_IMPLEMENTATION=rmw_zenoh_cpp, and a router \
                 on each host (wm zenoh-router)",
            ),
        };
        findings.push(
            Finding::warning(CHECK, format!("nobody else in domain {domain} over {name}"))
                .because("no driver is running, or it is in another domain, uses another middleware, or is out of reach")
                .fix(fix),
        );
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;
    use std::net::IpAddr;

    fn network(reach: Reach, outer: &[&str]) -> Network {
        let interface = |(name, address): (&str, &str)| Interface {
            name: name.to_owned(),
            address: address.parse::<IpAddr>().unwrap(),
        };
        let mut interfaces = vec![interface(("lo", "127.0.0.1"))];
        interfaces.extend(outer.iter().map(|name| interface((name, "10.0.0.7"))));
        Network {
            domain: 3,
            reach,
            middleware: Middleware::Dds,
            interfaces,
            listeners: BTreeMap::new(),
            warnings: Vec::new(),
        }
    }

    #[test]
    fn participants_are_counted_by_their_ports() {
        let line = |port: u16| {
            format!("  1: 00000000:{port:04X} 00000000:0000 07 00000000:00000000 00:00000000\n")
        };
        // domain 0: multicast and two participants with a data port each; domain 42: one participant; and ports of
        // other programs
        let ports = [7400, 7410, 7411, 7412, 7413, 17_910, 53, 40_000];
        let text: String = std::iter::once("  sl  local_address\n".to_owned())
            .chain(ports.map(line))
            .collect();
        assert_eq!(listeners_of(&text), BTreeMap::from([(0, 2), (42, 1)]));
        assert_eq!(listeners_of(""), BTreeMap::new());
    }

    #[test]
    fn loopback_finding_suggests_an_interface() {
        let findings = check(&network(Reach::Localhost, &["eth0", "wlan0"]), false);
        assert_eq!(findings[0].level, Level::Note);
        assert!(
            findings[0]
                .fix
                .as_deref()
                .unwrap()
                .contains("--interface eth0")
        );
        assert_eq!(findings.len(), 1);
    }

    /// `--interface` is about DDS.
    #[test]
    fn over_zenoh_the_router_is_named_instead_of_an_interface() {
        let mut network = network(Reach::Localhost, &["eth0"]);
        network.middleware = Middleware::Zenoh;
        let text = format!("{:?}", check(&network, true));
        assert!(text.contains("domain 3, over Zenoh") && text.contains("wm zenoh-router"));
        assert!(!text.contains("--interface"), "{text}");
    }

    #[test]
    fn two_interfaces_are_a_warning() {
        let level = |outer: &[&str]| check(&network(Reach::Subnet, outer), false)[0].level;
        assert_eq!(level(&["eth0"]), Level::Ok);
        assert_eq!(level(&["eth0", "wlan0"]), Level::Warning);
        assert_eq!(
            check(&network(Reach::Process, &[]), false)[0].level,
            Level::Warning
        );
    }

    #[test]
    fn unsupported_environment_variable_is_reported_with_a_fix() {
        let mut network = network(Reach::Localhost, &[]);
        let fix = "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp".to_owned();
        let problem = "RMW_IMPLEMENTATION is `rmw_zenoh_cpp`".to_owned();
        network.warnings.push(EnvironmentWarning { problem, fix });
        let finding = &check(&network, false)[1];
        assert_eq!(finding.level, Level::Warning);
        assert!(finding.what.contains("rmw_zenoh_cpp"), "{finding:?}");
        let fix = finding.fix.as_deref().unwrap();
        assert!(fix.contains("rmw_fastrtps_cpp"), "{finding:?}");
    }

    #[test]
    fn silent_domain_names_domains_with_participants() {
        let mut silent = network(Reach::Localhost, &[]);
        let text = |network: &Network| format!("{:?}", check(network, true)[1]);
        assert!(text(&silent).contains("start the drivers"));
        silent.listeners.insert(7, 2);
        assert!(text(&silent).contains("export ROS_DOMAIN_ID=7"));
        assert_eq!(check(&silent, false).len(), 1);
    }
}
