//! Bridges as processes, and nodes of a domain in this process.

pub use crate::fresh_domain::fresh_domain;
pub use crate::ros2_peer::{in_domain, root};
use rustix::process::{Pid, Signal};
use std::{
    ffi::OsStr,
    net::TcpListener,
    os::unix::process::CommandExt as _,
    path::PathBuf,
    process::{Child, Command, ExitStatus, Stdio},
    time::{Duration, Instant},
};
use wm_msgs::std_msgs::String as Text;
use wm_ros::{
    Context, Environment, Middleware, Node, NodeArgs, Publisher, Reach, Role, Subscription,
};

/// Far longer than anything on one host; only ends a hanging test.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The program under test.
pub const BRIDGE: &str = "wm-bridge";

/// Where cargo puts a program of the workspace: one folder above the tests.
pub fn program(name: &str) -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    tests.parent().unwrap().with_file_name(name)
}

/// A free endpoint on this host.
pub fn fresh_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    format!("tcp/{}", listener.local_addr().unwrap())
}

pub async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} took more than {PATIENCE:?}"))
}

pub fn text(data: &str) -> Text {
    Text {
        data: data.to_owned(),
    }
}

/// A process that is ended by its pid when this is dropped.
pub struct Process {
    child: Child,
}

impl Process {
    /// Starts it; its stderr goes to the test's own.
    pub fn start(mut command: Command) -> Self {
        // in its own process group, so that its children end with it
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

/// The bridge of a domain on loopback.
pub fn bridge(domain: u16, args: &[impl AsRef<OsStr>]) -> Process {
    let mut command = Command::new(program(BRIDGE));
    command.args(args);
    in_domain(&mut command, domain);
    Process::start(command)
}

/// The nodes' program, which cargo builds when it tests the workspace; `None` (with a message) if it is missing.
pub fn wm() -> Option<PathBuf> {
    let wm = program("wm");
    if wm.is_file() {
        return Some(wm);
    }
    eprintln!(
        "skipped: no {}; run tests/run, or `cargo build --release` first",
        wm.display()
    );
    assert!(
        std::env::var_os("CI").is_none(),
        "the nodes' program may not be missing in CI"
    );
    None
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
            middleware: Middleware::Dds,
        })
        .unwrap();
        let node = Node::new(&context, "site", "/wm", &NodeArgs::default()).unwrap();
        Self { node, context }
    }
}

/// Waits until only the bridge subscribes to a topic.
pub async fn gone(domain: u16, topic: &str) {
    let observer = Site::join(domain);
    let mut changes = observer.node.graph_changes();
    let is_there = |role, name: &str| {
        let endpoints = observer.node.remote_endpoints();
        let mut endpoints = endpoints.iter();
        endpoints.any(|endpoint| endpoint.role == role && endpoint.name == name)
    };
    soon("seeing the subscriptions go", async {
        // when it knows the bridge's publisher, it knows all endpoints
        while !is_there(Role::Publisher, topic) || is_there(Role::Subscription, topic) {
            changes.changed().await.unwrap();
        }
    })
    .await;
}

impl Drop for Site {
    fn drop(&mut self) {
        self.context.close();
    }
}

/// Publishes numbered messages from both sides; each subscription must get each of them once and in order.
pub async fn no_echo(
    publishers: [&Publisher<Text>; 2],
    mut subscriptions: [&mut Subscription<Text>; 2],
) {
    for number in 0..20 {
        for (publisher, side) in publishers.iter().zip(["here", "there"]) {
            publisher
                .publish(&text(&format!("{side} {number}")))
                .unwrap();
        }
    }
    for subscription in &mut subscriptions {
        let mut messages = Vec::new();
        while messages.len() < 40 {
            messages.push(after_greetings(subscription).await);
        }
        for side in ["here", "there"] {
            let of_side: Vec<_> = messages
                .iter()
                .filter(|text| text.starts_with(side))
                .collect();
            let expected: Vec<_> = (0..20).map(|number| format!("{side} {number}")).collect();
            assert_eq!(of_side, expected.iter().collect::<Vec<_>>());
        }
    }
    // one more of each: an echo would arrive before it
    for (publisher, words) in publishers.iter().zip(["last", "very last"]) {
        publisher.publish(&text(words)).unwrap();
        for subscription in &mut subscriptions {
            assert_eq!(after_greetings(subscription).await, words);
        }
    }
}

/// The next message after those that a test repeats until the first of them arrives.
async fn after_greetings(subscription: &mut Subscription<Text>) -> String {
    loop {
        let received = soon("a message", subscription.recv()).await;
        let text = received.unwrap().message.data;
        if !text.starts_with("hello") {
            return text;
        }
    }
}
