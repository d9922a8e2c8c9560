//! Nodes of two hosts: a long stream, cuts of the network, an interface that gets another address.

use super::{
    harness::{Process, fresh_domain, given, node, peers, rclpy, role},
    network::{Cut, ETHERNET, FIRST, Network, SECOND, must},
};
use std::{
    path::Path,
    time::{Duration, Instant},
};
use wm_msgs::std_msgs;
use wm_ros::{Context, Environment, Error, Middleware, Qos, Reach};

const TYPE: &str = "std_msgs/msg/UInt8MultiArray";
const KIB: usize = 1024;

/// Everything works again this long after the network does.
const RETURN: Duration = Duration::from_secs(10);
/// And on a busy machine, a little later.
const SLACK: Duration = Duration::from_secs(4);

/// What a station has printed last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Report {
    sent: u32,
    came: u32,
    lost: u32,
    text: u32,
}

impl Report {
    fn parse(line: &str) -> Option<Self> {
        let mut report = Self::default();
        let mut words = line.split_whitespace();
        while let (Some(name), Some(value)) = (words.next(), words.next()) {
            let value = value.parse().ok()?;
            match name {
                "sent" => report.sent = value,
                "came" => report.came = value,
                "lost" => report.lost = value,
                "text" => report.text = value,
                _ => return None,
            }
        }
        Some(report)
    }
}

/// One of two hosts: publishes a stream and a latched text, subscribes to those of the other host, and prints twice a
/// second what has come, until it is killed. The argument: own name, the other's, address or SUBNET, rate \[Hz\], size
/// \[byte\].
#[test]
#[ignore = "started by the tests of this module"]
fn station() {
    let (domain_id, argument) = given();
    let words: Vec<&str> = argument.split(' ').collect();
    let [own, other, at, rate, size] = words[..] else {
        panic!("{argument}")
    };
    let reach = match at {
        "SUBNET" => Reach::Subnet,
        address => Reach::Interfaces(vec![address.parse().unwrap()]),
    };
    let period = Duration::from_secs_f64(1.0 / rate.parse::<f64>().unwrap());
    let size: usize = size.parse().unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let context = Context::new(&Environment {
            domain_id,
            reach,
            middleware: Middleware::Dds,
        })
        .unwrap();
        let node = node(&context, &format!("station_{own}"), "");
        let topic = |name: &str, what: &str| format!("/{name}/{what}");
        let stream = node
            .raw_publisher(&topic(own, "stream"), TYPE, Qos::reliable(10))
            .unwrap();
        let text = node
            .publisher::<std_msgs::String>(&topic(own, "text"), Qos::latched(1))
            .unwrap();
        let data = own.to_owned();
        text.publish(&std_msgs::String { data }).unwrap();
        let mut streams = node
            .raw_subscription(&topic(other, "stream"), TYPE, Qos::reliable(100))
            .unwrap();
        let mut texts = node
            .subscription::<std_msgs::String>(&topic(other, "text"), Qos::latched(1))
            .unwrap();
        let message = super::laggards::message(7, size);
        let mut beat = tokio::time::interval(period);
        let mut news = tokio::time::interval(Duration::from_millis(500));
        let mut report = Report::default();
        let shutdown = context.shutdown();
        loop {
            tokio::select! {
                () = shutdown.wait() => break,
                _ = beat.tick() => {
                    stream.publish(message.clone()).unwrap();
                    report.sent += 1;
                }
                Some(_) = streams.recv() => report.came += 1,
                Some(_) = texts.recv() => report.text += 1,
                _ = news.tick() => {
                    let Report { sent, came, text, .. } = report;
                    println!("sent {sent} came {came} lost {} text {text}", streams.lost());
                }
            }
        }
    });
}

/// Who is on the second host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Other {
    Wm,
    Rclpy,
    /// With a stream of small messages of its own.
    RclpyListens,
    /// And on the first one: what the network and the machine allow.
    RclpyOnBoth,
}

/// A station on each host.
struct Pair {
    network: Network,
    stations: [Process; 2],
    last: [Report; 2],
}

impl Pair {
    fn start(
        network: Network,
        peers: &Path,
        domain: u16,
        other: Other,
        at: [&str; 2],
        stream: (f64, usize),
    ) -> Self {
        let (rate, size) = stream;
        let wm = |host: &str, [own, peer]: [&str; 2], at: &str| {
            let argument = format!("{own} {peer} {at} {rate} {size}");
            role(&Network::on(host), "hosts::station", domain, &argument)
        };
        let rclpy = |host: &str, [own, peer]: [&str; 2]| {
            let size = match other {
                Other::RclpyListens => 1000,
                Other::Wm | Other::Rclpy | Other::RclpyOnBoth => size,
            };
            let words = [own, peer, &rate.to_string(), &size.to_string()];
            let python = rclpy(peers, domain, "station.py", &words);
            let on = Network::on(host);
            let mut command = std::process::Command::new(on[0]);
            command
                .args(&on[1..])
                .arg(python.get_program())
                .args(python.get_args())
                .env("ROS_DOMAIN_ID", domain.to_string())
                .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
            command
        };
        let (forth, back) = (["first", "second"], ["second", "first"]);
        let first = match other {
            Other::Wm | Other::Rclpy | Other::RclpyListens => wm(&network.first, forth, at[0]),
            Other::RclpyOnBoth => rclpy(&network.first, forth),
        };
        let second = match other {
            Other::Wm => wm(&network.second, back, at[1]),
            Other::Rclpy | Other::RclpyListens | Other::RclpyOnBoth => rclpy(&network.second, back),
        };
        let stations = [first, second].map(Process::start);
        let mut pair = Self {
            network,
            stations,
            last: [Report::default(); 2],
        };
        // both streams and both texts
        pair.wait("the start", Duration::from_secs(60), |reports| {
            reports
                .iter()
                .all(|report| report.came > 3 && report.text == 1)
        });
        pair
    }

    fn look(&mut self) -> [Report; 2] {
        for (station, last) in self.stations.iter().zip(&mut self.last) {
            if let Some(report) = station.last_line().as_deref().and_then(Report::parse) {
                *last = report;
            }
        }
        self.last
    }

    /// Waits until it is so; how long that took.
    fn wait(
        &mut self,
        what: &str,
        limit: Duration,
        is_so: impl Fn([Report; 2]) -> bool,
    ) -> Duration {
        let start = Instant::now();
        while !is_so(self.look()) {
            assert!(
                start.elapsed() < limit,
                "{what}: {:?} after {limit:?}",
                self.last
            );
            std::thread::sleep(Duration::from_millis(50));
        }
        start.elapsed()
    }

    /// Cuts the network for so long; how long after that everything works.
    fn survive(&mut self, name: &str, cut: Cut, length: Duration) -> Duration {
        let before = self.look();
        self.network.cut(cut);
        std::thread::sleep(length);
        let during = self.look();
        self.network.mend(cut);
        // not only what was under way: a stream goes on
        let took = self.wait(name, Duration::from_secs(120), |now| {
            now.iter()
                .zip(&during)
                .all(|(now, during)| now.came > during.came + 4)
        });
        // a text that comes again would come with the rest
        std::thread::sleep(Duration::from_secs(3));
        let after = self.look();
        println!(
            "{name}: everything after {took:.1?}; before {before:?}, during {during:?}, after {after:?}"
        );
        assert!(took < RETURN + SLACK, "{name}: {took:?}");
        for report in after {
            assert_eq!(
                report.text, 1,
                "{name}: a latched message came again: {report:?}"
            );
        }
        took
    }
}

/// Messages that each side received, and those that were sent to it, for so long.
fn count(pair: &mut Pair, name: &str, length: Duration) -> [[u32; 2]; 2] {
    let begin = pair.look();
    std::thread::sleep(length);
    let end = pair.look();
    println!("{name}: {begin:?} to {end:?}");
    [(0, 1), (1, 0)].map(|(receiver, sender)| {
        let came = end[receiver].came - begin[receiver].came;
        let sent = end[sender].sent - begin[sender].sent;
        assert_eq!(end[receiver].lost, begin[receiver].lost, "{name}: {end:?}");
        [came, sent]
    })
}

/// For so long, no message of either side is lost.
fn nothing_is_lost(pair: &mut Pair, name: &str, length: Duration) {
    for [came, sent] in count(pair, name, length) {
        // what was under way at either end
        assert!(came + 20 > sent, "{name}: {came} of {sent}");
    }
}

const SUBNET: [&str; 2] = ["SUBNET", "SUBNET"];
const NAMED: [&str; 2] = [FIRST, SECOND];

/// A forged acknowledgement from loopback, for one, makes rustdds send everything to this host after half a minute.
#[test]
fn two_hosts_lose_nothing_in_a_minute() {
    let Some(peers) = peers() else { return };
    let cases = [
        (
            "wm and wm, every interface, 48 KiB",
            Other::Wm,
            SUBNET,
            (30.0, 48 * KIB),
        ),
        (
            "wm and wm, every interface, 512 KiB",
            Other::Wm,
            SUBNET,
            (5.0, 512 * KIB),
        ),
        (
            "wm and rclpy, every interface, 48 KiB",
            Other::Rclpy,
            SUBNET,
            (30.0, 48 * KIB),
        ),
        (
            "wm and rclpy, every interface, 512 KiB",
            Other::Rclpy,
            SUBNET,
            (5.0, 512 * KIB),
        ),
    ];
    side_by_side(&peers, &cases, |pair, name| {
        nothing_is_lost(pair, name, Duration::from_secs(45));
    });
}

type Case = (&'static str, Other, [&'static str; 2], (f64, usize));

/// Runs the cases at the same time, each on two hosts of its own.
fn side_by_side(peers: &Path, cases: &[Case], run: impl Fn(&mut Pair, &str) + Sync) {
    std::thread::scope(|scope| {
        for (name, other, at, stream) in cases {
            let run = &run;
            scope.spawn(move || {
                let Some(network) = Network::new() else {
                    return;
                };
                let mut pair = Pair::start(network, peers, fresh_domain(), *other, *at, *stream);
                run(&mut pair, name);
            });
        }
    });
}

/// The leases are 20 s for a participant of Fast DDS and 50 s for one of rustdds.
#[test]
fn streams_return_with_the_network_after_a_cut() {
    let Some(peers) = peers() else { return };
    let cuts = [
        ("wm and wm, both directions", Other::Wm, Cut::Both, 58),
        ("wm and rclpy, both directions", Other::Rclpy, Cut::Both, 35),
        ("wm and rclpy, to rclpy", Other::Rclpy, Cut::ToSecond, 58),
    ];
    let cases = cuts.map(|(name, other, ..)| (name, other, SUBNET, (10.0, 1000)));
    side_by_side(&peers, &cases, |pair, name| {
        for (_, _, cut, seconds) in cuts.iter().filter(|cut| cut.0 == name) {
            pair.survive(name, *cut, Duration::from_secs(*seconds));
        }
    });
}

/// All lengths and sides, at the same time; three minutes.
#[test]
#[ignore = "long: cargo test -p wm_ros --test peers -- --ignored every_cut"]
fn every_cut_ends_with_the_network() {
    let Some(peers) = peers() else { return };
    let wanted = std::env::var("CUTS").unwrap_or_default();
    let mut failed = 0;
    std::thread::scope(|scope| {
        let mut runs = Vec::new();
        for seconds in [15, 35, 70, 120] {
            for cut in [Cut::Both, Cut::ToFirst, Cut::ToSecond, Cut::Cable] {
                for other in [Other::Wm, Other::Rclpy] {
                    let name = format!("{other:?} {cut:?} {seconds}");
                    if !wanted.split(',').all(|word| name.contains(word)) {
                        continue;
                    }
                    let peers = &peers;
                    runs.push(scope.spawn(move || {
                        let Some(network) = Network::new() else {
                            return;
                        };
                        let mut pair =
                            Pair::start(network, peers, fresh_domain(), other, SUBNET, (5.0, 1000));
                        pair.survive(&name, cut, Duration::from_secs(seconds));
                    }));
                }
            }
        }
        failed = runs.into_iter().filter_map(|run| run.join().err()).count();
    });
    assert_eq!(failed, 0);
}

/// Two minutes at every rate and size, one after the other; `STREAMS` chooses some: `STREAMS="Wm SUBNET"`.
#[test]
#[ignore = "long: cargo test -p wm_ros --test peers -- --ignored two_minutes --nocapture"]
fn two_hosts_lose_nothing_in_two_minutes() {
    let Some(peers) = peers() else { return };
    let wanted = std::env::var("STREAMS").unwrap_or_default();
    let mut failed = Vec::new();
    let others = [
        Other::Wm,
        Other::RclpyListens,
        Other::Rclpy,
        Other::RclpyOnBoth,
    ];
    for other in others {
        for at in [SUBNET, NAMED] {
            for (size, rate) in [(48, 5.0), (48, 30.0), (512, 5.0), (512, 30.0)] {
                let name = format!("{other:?} {} {size} KiB {rate} Hz", at[0]);
                let words: Vec<&str> = name.split(' ').collect();
                if !wanted.split_whitespace().all(|word| words.contains(&word)) {
                    continue;
                }
                let Some(network) = Network::new() else {
                    return;
                };
                let stream = (rate, size * KIB);
                let run = std::panic::AssertUnwindSafe(|| {
                    let mut pair = Pair::start(network, &peers, fresh_domain(), other, at, stream);
                    let length = Duration::from_secs(120);
                    match other {
                        Other::Wm | Other::RclpyListens | Other::Rclpy => {
                            nothing_is_lost(&mut pair, &name, length);
                        }
                        Other::RclpyOnBoth => drop(count(&mut pair, &name, length)),
                    }
                });
                if std::panic::catch_unwind(run).is_err() {
                    failed.push(name);
                }
            }
        }
    }
    assert!(failed.is_empty(), "messages were lost: {failed:?}");
}

/// Runs as a node does, and prints the error that ends it.
#[test]
#[ignore = "started by the test of this module"]
fn node_on_ethernet() {
    let line = ["--interface", ETHERNET];
    let args = wm_ros::NodeArgs::parse(line).unwrap();
    let result = wm_ros::run("node", "/wm", &args, async |node| -> Result<(), Error> {
        println!("it runs");
        node.shutdown().wait().await;
        Ok(())
    });
    println!("ended: {}", result.unwrap_err());
}

#[test]
fn a_node_ends_when_its_address_changes() {
    let Some(network) = Network::new() else {
        return;
    };
    let host = &network.first;
    let on = Network::on(host);
    let node = Process::start(role(&on, "hosts::node_on_ethernet", fresh_domain(), ""));
    node.says("it runs");
    must(&format!("ip -n {host} addr del {FIRST}/24 dev {ETHERNET}"));
    must(&format!(
        "ip -n {host} addr add 10.213.7.9/24 dev {ETHERNET}"
    ));
    let error = node.says("ended: ");
    assert!(
        error.contains(ETHERNET) && error.contains("from 10.213.7.1 to 10.213.7.9"),
        "{error}"
    );
    assert!(node.finish().success());
    // as a supervisor would
    let node = Process::start(role(&on, "hosts::node_on_ethernet", fresh_domain(), ""));
    node.says("it runs");
}
