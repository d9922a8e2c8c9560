//! A slow and lossy link between two network namespaces, which act as machines.

use crate::harness::{Process, Site, in_domain};
use std::{
    fs::File,
    io::{BufRead as _, BufReader, Write as _},
    os::fd::AsFd as _,
    path::Path,
    process::{Child, Command, Stdio},
    time::Duration,
};

/// From end to end.
pub const DELAY: Duration = Duration::from_millis(50);
/// The share of lost packets.
const LOSS: f64 = 0.02;
const SEED: u32 = 7;
const CONGESTION_CONTROL: &str = "bbr";

fn ip(args: &[&str]) -> bool {
    let status = Command::new("ip").args(args).status();
    status.is_ok_and(|status| status.success())
}

/// Two namespaces and the link between them, until dropped.
pub struct Link {
    namespaces: [String; 2],
    relay: Child,
    output: BufReader<std::process::ChildStdout>,
}

impl Link {
    /// `None`, with a message, without the necessary rights.
    pub fn new() -> Option<Self> {
        let skip = |reason: &str| eprintln!("skipped: the test over a lossy link {reason}");
        if !rustix::process::geteuid().is_root() {
            skip("needs root");
            return None;
        }
        if File::options()
            .read(true)
            .write(true)
            .open("/dev/net/tun")
            .is_err()
        {
            skip("needs /dev/net/tun");
            return None;
        }
        let namespaces = ["a", "b"].map(|end| format!("wm{}{end}", std::process::id()));
        for namespace in &namespaces {
            if !ip(&["netns", "add", namespace]) {
                skip("needs `ip netns add`");
                return None;
            }
        }
        let mut relay = Command::new("python3")
            .arg(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/tests/processes/link.py"
            ))
            .args(&namespaces)
            .args([
                DELAY.as_millis().to_string(),
                LOSS.to_string(),
                SEED.to_string(),
            ])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut link = Self {
            namespaces,
            output: BufReader::new(relay.stdout.take().unwrap()),
            relay,
        };
        assert_eq!(link.line(), "ready");
        for namespace in &link.namespaces {
            // a fixed congestion control, since it decides the link's throughput under loss
            let set =
                format!("echo {CONGESTION_CONTROL} > /proc/sys/net/ipv4/tcp_congestion_control");
            if !ip(&["netns", "exec", namespace, "sh", "-c", &set]) {
                skip(&format!(
                    "needs the TCP congestion control {CONGESTION_CONTROL}"
                ));
                return None;
            }
        }
        Some(link)
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        line.trim_end().to_owned()
    }

    /// Starts a program at this end.
    pub fn start(&self, end: usize, program: &Path, args: &[&str]) -> Process {
        let mut command = Command::new("ip");
        command
            .args(["netns", "exec", &self.namespaces[end]])
            .arg(program)
            .args(args);
        // both machines use the same domain: only the bridges connect them
        in_domain(&mut command, 0);
        Process::start(command)
    }

    /// A participant at this end: its sockets and threads belong to the namespace.
    pub fn site(&self, end: usize) -> Site {
        let path = format!("/run/netns/{}", self.namespaces[end]);
        let joining = std::thread::spawn(move || {
            let file = File::open(path).unwrap();
            rustix::thread::move_into_link_name_space(file.as_fd(), None).unwrap();
            Site::join(0)
        });
        joining.join().unwrap()
    }

    /// Drops all packets for this long.
    pub fn fail_for(&mut self, outage: Duration) {
        let input = self.relay.stdin.as_mut().unwrap();
        writeln!(input, "{}", outage.as_secs_f64()).unwrap();
    }

    /// The numbers of packets and of dropped ones.
    pub fn finish(mut self) -> (u64, u64) {
        drop(self.relay.stdin.take());
        let line = self.line();
        let (count, dropped) = line.split_once(' ').unwrap();
        (count.parse().unwrap(), dropped.parse().unwrap())
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        if matches!(self.relay.try_wait(), Ok(None)) {
            self.relay.kill().ok();
            self.relay.wait().ok();
        }
        for namespace in &self.namespaces {
            ip(&["netns", "delete", namespace]);
        }
    }
}
