//! Other processes for a test: this very program in another role, and peers that nobody here wrote.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};
use wm_ros::{Context, Environment, Node, NodeArgs, Reach};

/// Far above anything that a test takes; it only ends one that hangs.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// A domain for each test, so that tests neither meet each other nor another run of them.
pub fn domain(test: u16) -> u16 {
    // domains up to 101 keep RTPS ports below the ephemeral range of Linux
    20 + (std::process::id() % 9) as u16 * 9 + test
}

pub fn context(domain_id: u16) -> Context {
    let reach = Reach::Localhost;
    Context::new(&Environment { domain_id, reach }).unwrap()
}

pub fn node(context: &Context, name: &str) -> Node {
    let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
    Node::new(context, name, "/wm", &args).unwrap()
}

pub async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what} took more than {PATIENCE:?}"))
}

pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// The virtual environments that `tests/setup_ros2` made; `None` (with a plain message) where it was not run.
pub fn peers() -> Option<PathBuf> {
    let dir = root().join(".venv");
    if dir.join("stamp").is_file() {
        return Some(dir);
    }
    eprintln!("skipped: no ROS 2 peer under .venv; run tests/setup_ros2 (tests/run does)");
    assert!(
        std::env::var_os("CI").is_none(),
        "the interoperability tests may not be skipped in CI"
    );
    None
}

/// A command that plays `role`, behind the words of `before` (`ip netns exec`, say).
pub fn role(before: &[&str], role: &str, domain: u16, argument: &str) -> Command {
    let program = std::env::current_exe().unwrap();
    let mut words = before.iter().map(std::ffi::OsString::from);
    let mut command = match words.next() {
        Some(first) => {
            let mut command = Command::new(first);
            command.args(words).arg(program);
            command
        }
        None => Command::new(program),
    };
    command
        .args(["--ignored", "--exact", "--nocapture", role])
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ARGUMENT", argument);
    command
}

/// What a role was given: its domain and its argument.
pub fn given() -> (u16, String) {
    let variable = |name| std::env::var(name).expect("started by another test");
    (
        variable("ROS_DOMAIN_ID").parse().unwrap(),
        variable("ARGUMENT"),
    )
}

/// A Python program under `tests/interop`, run by the real ROS 2 of [`peers`].
pub fn rclpy(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Command {
    let mut command = Command::new("bash");
    command
        .args(["-c", ". \"$0\" && exec python \"$@\""])
        .arg(peers.join("ros2/ros2_env.sh"))
        .arg(root().join("tests/interop").join(script))
        .args(args)
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command
}

/// A started process, ended by its pid when the test lets go of it.
pub struct Process {
    child: Child,
    lines: Receiver<String>,
}

impl Process {
    /// Its stdout is read line by line, its stderr is the test's own.
    pub fn start(mut command: Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self { child, lines }
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Reads until a line that contains `text`.
    pub fn says(&self, text: &str) -> String {
        let start = Instant::now();
        while let Some(left) = PATIENCE.checked_sub(start.elapsed()) {
            match self.lines.recv_timeout(left) {
                Ok(line) if line.contains(text) => return line,
                Ok(_) => {}
                Err(RecvTimeoutError::Disconnected) => panic!("ended without `{text}`"),
                Err(RecvTimeoutError::Timeout) => break,
            }
        }
        panic!("no `{text}` within {PATIENCE:?}");
    }

    /// The last line so far.
    pub fn last_line(&self) -> Option<String> {
        self.lines.try_iter().last()
    }

    /// Waits for the end.
    pub fn finish(mut self) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(start.elapsed() < PATIENCE, "it goes on");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }
}

/// Resident memory of this process \[byte\].
pub fn resident() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kib.unwrap() * 1024
}
