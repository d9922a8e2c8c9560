//! Bridges as processes, and nodes of a domain in this process.

use rustix::process::{Pid, Signal};
use std::{
    ffi::OsStr,
    net::TcpListener,
    os::unix::process::CommandExt as _,
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    sync::atomic::{AtomicU16, Ordering},
    time::{Duration, Instant},
};
use wm_msgs::std_msgs;
use wm_ros::{Context, Environment, Node, NodeArgs, Reach};

/// Far above anything that happens on one host; it only ends a test that hangs.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// The program under test.
pub const BRIDGE: &str = env!("CARGO_BIN_EXE_wm-bridge");

/// The root of the repository.
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// A ROS domain that no other test of this run uses.
pub fn fresh_domain() -> u16 {
    // Domains up to 101 keep RTPS ports below the ephemeral range of Linux.
    static NEXT: AtomicU16 = AtomicU16::new(0);
    20 + (std::process::id() as u16 % 5) * 16 + NEXT.fetch_add(1, Ordering::Relaxed) % 16
}

/// An endpoint on this host that nobody listens on.
pub fn fresh_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

pub async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} took more than {PATIENCE:?}"))
}

pub fn text(data: &str) -> std_msgs::String {
    std_msgs::String {
        data: data.to_owned(),
    }
}

/// A process that is ended by its pid when the test lets go of it.
pub struct Process {
    child: Child,
}

impl Process {
    /// Starts it; its stderr goes to the test's own.
    pub fn start(mut command: Command) -> Self {
        // A group of its own: what the process started ends with it.
        let child = command
            .stdin(Stdio::null())
            .process_group(0)
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?}: {error}"));
        Self { child }
    }

    pub fn signal(&self, signal: Signal) {
        rustix::process::kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Waits for its end.
    pub fn finish(mut self, limit: Duration) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < limit, "no end within {limit:?}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let group = Pid::from_child(&self.child);
            rustix::process::kill_process_group(group, Signal::KILL).ok();
            self.child.wait().ok();
        }
    }
}

/// The bridge of a domain on loopback; `inside` is what runs it, for example `ip netns exec NAME`.
pub fn bridge_inside(inside: &[&str], domain: u16, args: &[impl AsRef<OsStr>]) -> Process {
    let (program, rest) = match inside {
        [] => (BRIDGE, &[][..]),
        [program, rest @ ..] => (*program, rest),
    };
    let mut command = Command::new(program);
    command.args(rest);
    if !inside.is_empty() {
        command.arg(BRIDGE);
    }
    command
        .args(args)
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env_remove("ROS_LOCALHOST_ONLY");
    Process::start(command)
}

pub fn bridge(domain: u16, args: &[impl AsRef<OsStr>]) -> Process {
    bridge_inside(&[], domain, args)
}

/// A participant of this process in a domain, with one node.
pub struct Site {
    pub node: Node,
    context: Context,
}

impl Site {
    pub fn join(domain_id: u16) -> Self {
        let context = Context::new(&Environment {
            domain_id,
            reach: Reach::Localhost,
        })
        .unwrap();
        let node = Node::new(&context, "site", "/wm", &NodeArgs::default()).unwrap();
        Self { node, context }
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        self.context.close();
    }
}
