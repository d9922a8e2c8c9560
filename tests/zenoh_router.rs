//! `wm zenoh-router`, and the router that `wm launch` starts.

use crate::harness::{Signal, WM, children, root, wait_until};
use rustix::process::Pid;
use std::{
    io::{BufRead as _, BufReader, Read as _},
    net::{TcpListener, TcpStream},
    os::unix::process::CommandExt as _,
    process::{Child, ChildStderr, Command, Stdio},
    time::Duration,
};

const LIMIT: Duration = Duration::from_secs(30);

/// A free endpoint on this host, and its address.
fn fresh_endpoint() -> (String, String) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    (format!("tcp/{address}"), address)
}

fn wm(arguments: &[&str]) -> Command {
    let mut command = Command::new(WM);
    command
        .args(arguments)
        .current_dir(root())
        .env_remove("ZENOH_CONFIG_OVERRIDE")
        .env_remove("ZENOH_ROUTER_CONFIG_URI")
        .env_remove("ZENOH_SESSION_CONFIG_URI")
        .env_remove("RMW_IMPLEMENTATION");
    command
}

/// Its session waits a minute for an answer.
#[test]
fn node_that_waits_for_a_silent_router_ends_when_asked() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let connects = format!("mode=\"client\";connect/endpoints=[\"tcp/{address}\"]");
    let mut node = wm(&["monitor", "--middleware", "zenoh"]);
    node.env("ZENOH_CONFIG_OVERRIDE", connects);
    let node = Logged::start(node);
    let _connection = silent.accept().unwrap();
    node.signal(Signal::TERM);
    let (code, log) = node.finish();
    assert_eq!(code, Some(0), "{log}");
    assert!(log.contains("while it still joined the graph"), "{log}");
}

/// A program whose stderr the test reads.
struct Logged {
    child: Child,
    log: BufReader<ChildStderr>,
}

impl Logged {
    fn start(mut command: Command) -> Self {
        command.stdin(Stdio::null()).stderr(Stdio::piped());
        command.process_group(0);
        let mut child = command.spawn().unwrap();
        let log = BufReader::new(child.stderr.take().unwrap());
        Self { child, log }
    }

    /// Reads its log up to a line with `text`, and returns what it read.
    fn read_to(&mut self, text: &str) -> String {
        let mut read = String::new();
        while !read.contains(text) {
            let length = self.log.read_line(&mut read).unwrap();
            assert!(length > 0, "the log ended without {text:?}: {read}");
        }
        read
    }

    fn signal(&self, signal: Signal) {
        let pid = Pid::from_child(&self.child);
        rustix::process::kill_process(pid, signal).unwrap();
    }

    /// Waits for its end; returns its exit code and the rest of its log.
    fn finish(mut self) -> (Option<i32>, String) {
        let mut rest = String::new();
        self.log.read_to_string(&mut rest).unwrap();
        (self.child.wait().unwrap().code(), rest)
    }
}

impl Drop for Logged {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let pid = Pid::from_child(&self.child);
            let _ = rustix::process::kill_process_group(pid, Signal::KILL);
            let _ = self.child.wait();
        }
    }
}

#[test]
fn router_serves_until_a_signal_and_ends_with_0() {
    for signal in [Signal::INT, Signal::TERM] {
        let (endpoint, address) = fresh_endpoint();
        let mut router = Logged::start(wm(&["zenoh-router", "--listen", &endpoint]));
        let log = router.read_to("[zenoh_router]: Zenoh router ");
        assert!(log.contains(&format!("listens on {endpoint}")), "{log}");
        TcpStream::connect(&address).unwrap();
        router.signal(signal);
        let (code, log) = router.finish();
        assert_eq!(code, Some(0), "{log}");
        assert!(log.contains("[zenoh_router]: ended by SIG"), "{log}");
    }
}

#[test]
fn second_router_names_the_first() {
    let (endpoint, _) = fresh_endpoint();
    let mut first = Logged::start(wm(&["zenoh-router", "--listen", &endpoint]));
    first.read_to("listens on");
    let second = Logged::start(wm(&["zenoh-router", "--listen", &endpoint]));
    let (code, log) = second.finish();
    let who = format!(
        "is in use by process {} ({WM} zenoh-router",
        first.child.id()
    );
    assert!(log.contains(&who), "{log}");
    assert_eq!(code, Some(1));
}

#[test]
fn invalid_settings_are_refused_by_name() {
    for (settings, expected) in [
        ("listen/endpoints", "ZENOH_CONFIG_OVERRIDE"),
        ("no/such/key=1", "no/such/key"),
        ("mode=\"client\"", "a router needs the mode \"router\""),
    ] {
        let mut command = wm(&["zenoh-router"]);
        command.env("ZENOH_CONFIG_OVERRIDE", settings);
        let (code, log) = Logged::start(command).finish();
        assert!(log.contains(expected), "{settings}: {log}");
        assert_ne!(code, Some(0), "{settings}");
    }
}

/// A launch of one process that uses Zenoh.
fn launch(folder: &tempfile::TempDir, endpoint: &str) -> Logged {
    let file = folder.path().join("one.launch.yaml");
    let text = "launch:\n- executable: {cmd: sleep 1000, name: user}\n";
    std::fs::write(&file, text).unwrap();
    let mut command = wm(&["launch", &file.to_string_lossy()]);
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    let settings = format!("connect/endpoints=[\"{endpoint}\"]");
    command.env("ZENOH_CONFIG_OVERRIDE", settings);
    Logged::start(command)
}

#[test]
fn launch_starts_and_stops_a_router() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, address) = fresh_endpoint();
    let mut launch = launch(&folder, &endpoint);
    launch.read_to(&format!("listens on {endpoint}"));
    TcpStream::connect(&address).unwrap();
    launch.signal(Signal::INT);
    let (code, log) = launch.finish();
    assert_eq!(code, Some(0), "{log}");
    assert!(log.contains("[zenoh_router]: ended by SIGINT"), "{log}");
    assert!(TcpStream::connect(&address).is_err());
}

#[test]
fn launch_leaves_a_running_router_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, address) = fresh_endpoint();
    let mut router = Logged::start(wm(&["zenoh-router", "--listen", &endpoint]));
    router.read_to("listens on");
    let launch = launch(&folder, &endpoint);
    // the launcher connects before it starts its processes
    let id = Pid::from_child(&launch.child);
    wait_until("the launch runs", LIMIT, || !children(id).is_empty());
    launch.signal(Signal::INT);
    let (code, log) = launch.finish();
    assert_eq!(code, Some(0), "{log}");
    assert!(!log.contains("zenoh-router"), "{log}");
    TcpStream::connect(&address).unwrap();
}
