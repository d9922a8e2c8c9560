//! Starts and stops real processes of the suite, each test in its own ROS domain on loopback.

pub use crate::fresh_domain::fresh_domain;
use std::{
    io::{BufRead as _, BufReader},
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant},
};

pub use crate::ros2_peer::{in_domain, over_zenoh, peers, rclpy, root, ros2_env};
use rustix::process::Pid;
pub use rustix::process::Signal;
use tempfile::NamedTempFile;
use wm_ros::{Context, Environment, Middleware, Node, NodeArgs, Reach};

/// The binary under test.
pub const WM: &str = env!("CARGO_BIN_EXE_wm");

/// The bundled bag.
pub fn bundled_bag() -> PathBuf {
    root().join("bags/tabletop")
}

/// `wm` with `args`, in ROS domain `domain`, on loopback.
pub fn wm(domain: u16, args: &[&str]) -> Command {
    let mut command = Command::new(WM);
    command.args(args).current_dir(root());
    in_domain(&mut command, domain);
    command
}

/// A player that repeats the bundled bag.
pub fn looping_player(domain: u16) -> Process {
    let bag = bundled_bag();
    Process::start(wm(
        domain,
        &["bag", "play", "--loop", &bag.to_string_lossy()],
    ))
}

/// The node `name` with these parameters, each `name:=value`.
pub fn wm_node(domain: u16, name: &str, parameters: &[&str]) -> Command {
    let parameters = parameters.iter().flat_map(|parameter| ["-p", parameter]);
    let arguments: Vec<&str> = [name, "--ros-args"].into_iter().chain(parameters).collect();
    wm(domain, &arguments)
}

/// A node of this process in ROS domain `domain_id`, on loopback.
pub fn join(domain_id: u16, name: &str) -> (Context, Node) {
    let environment = Environment {
        domain_id,
        reach: Reach::Localhost,
        middleware: Middleware::from_env().expect("a middleware of this build"),
    };
    let context = Context::new(&environment).expect("a context");
    let args = NodeArgs::parse(std::iter::empty::<&str>()).expect("no arguments");
    let node = Node::new(&context, name, "/wm", &args).expect("a node");
    (context, node)
}

/// Waits until each of these topics has a publisher, so that the nodes have started.
pub fn wait_for_publishers(domain_id: u16, topics: &[&str]) {
    let (_context, node) = join(domain_id, "observer");
    wait_until("the nodes are up", Duration::from_secs(60), || {
        let seen = node.topics();
        let is_published = |name: &&str| {
            let mut of_name = seen.iter().filter(|topic| topic.name == **name);
            of_name.any(|topic| !topic.publishers.is_empty())
        };
        topics.iter().all(is_published)
    });
}

/// Permits running all nodes: two suites at once are too much for two processors.
pub fn whole_suite() -> MutexGuard<'static, ()> {
    static ONE: Mutex<()> = Mutex::new(());
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A program of `examples`, with the real ROS 2 and the packages of the environment `packages`.
pub fn example(peers: &Path, packages: &str, domain: u16, script: &str, args: &[&str]) -> Command {
    let mut command = Command::new("bash");
    command
        .args([
            "-c",
            ". \"$0\" && export PYTHONPATH=\"$1:$PYTHONPATH\" && shift && exec python \"$@\"",
        ])
        .arg(ros2_env(peers))
        .arg(peers.join(packages).join("lib/python3.11/site-packages"))
        .arg(root().join("examples").join(script))
        .args(args);
    in_domain(&mut command, domain);
    command
}

/// A Python program under `tests/interop`, with the other libraries of [`peers`].
pub fn tool(peers: &Path, domain: u16, script: &str, args: &[&str]) -> Command {
    let mut command = Command::new(peers.join("tools/bin/python"));
    command
        .arg(root().join("tests/interop").join(script))
        .args(args)
        // set by the wheels of ROS 2; it would load their libraries into this Python
        .env_remove("LD_LIBRARY_PATH");
    in_domain(&mut command, domain);
    command
}

/// Waits until `is_so`, at most `limit`.
pub fn wait_until(what: &str, limit: Duration, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < limit, "{what}: not within {limit:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The result of `future`, if it comes within a minute.
pub async fn soon<T>(what: &str, future: impl Future<Output = T>) -> T {
    let limit = Duration::from_secs(60);
    let result = tokio::time::timeout(limit, future).await;
    result.unwrap_or_else(|_elapsed| panic!("{what}: not within {limit:?}"))
}

/// Resident memory of a process \[byte\].
pub fn resident(pid: Pid) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", pid.as_raw_nonzero()))
        .expect("the process runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kib.expect("a size in kB") * 1024
}

/// The children of `parent`, each with its command line.
pub fn children(parent: Pid) -> Vec<(Pid, Vec<String>)> {
    let parent = parent.as_raw_nonzero();
    let ids = std::fs::read_to_string(format!("/proc/{parent}/task/{parent}/children"))
        .expect("a kernel that lists children");
    let child = |id: &str| {
        let words = std::fs::read_to_string(format!("/proc/{id}/cmdline")).ok()?;
        let words = words.split('\0').map(str::to_owned).collect();
        Some((Pid::from_raw(id.parse().ok()?)?, words))
    };
    ids.split_whitespace().filter_map(child).collect()
}

/// Output of a process. A thread reads it continuously, because a process with a full pipe blocks.
struct Stdout {
    text: Arc<Mutex<String>>,
    reader: JoinHandle<()>,
}

impl Stdout {
    fn new(pipe: ChildStdout) -> Self {
        let text = Arc::new(Mutex::new(String::new()));
        let shared = Arc::clone(&text);
        let reader = std::thread::spawn(move || {
            let mut pipe = BufReader::new(pipe);
            let mut line = Vec::new();
            while matches!(pipe.read_until(b'\n', &mut line), Ok(1..)) {
                let line = std::mem::take(&mut line);
                let mut text = shared.lock().unwrap_or_else(PoisonError::into_inner);
                text.push_str(&String::from_utf8_lossy(&line));
            }
        });
        Self { text, reader }
    }

    fn text(&self) -> MutexGuard<'_, String> {
        self.text.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A process that is ended by its pid when this is dropped.
pub struct Process {
    child: Child,
    name: String,
    stdout: Option<Stdout>,
    /// A file: a pipe would stay open as long as any child of the process.
    stderr: Option<NamedTempFile>,
}

impl Process {
    /// Starts `command`; its stdout goes to [`Self::finish`], its stderr to the test's own when it has ended, so that only
    /// failed tests show it.
    pub fn start(mut command: Command) -> Self {
        let stderr = NamedTempFile::new().expect("a temporary file");
        let log = stderr.as_file().try_clone().expect("an open file");
        command.stdout(Stdio::piped()).stderr(log);
        let mut process = Self::start_with_output(command);
        let stdout = process.child.stdout.take().expect("stdout is piped");
        process.stdout = Some(Stdout::new(stdout));
        process.stderr = Some(stderr);
        process
    }

    /// Starts `command` with its own stdout and stderr.
    pub fn start_with_output(mut command: Command) -> Self {
        let name = format!("{command:?}");
        command.stdin(Stdio::null());
        // in its own process group, so that its children end with it
        command.process_group(0);
        let child = command
            .spawn()
            .unwrap_or_else(|error| panic!("could not start {name}: {error}"));
        Self {
            child,
            name,
            stdout: None,
            stderr: None,
        }
    }

    /// The stderr of the process so far.
    pub fn stderr(&self) -> String {
        let Some(log) = &self.stderr else {
            return String::new();
        };
        let bytes = std::fs::read(log.path()).expect("the log");
        String::from_utf8_lossy(&bytes).into_owned()
    }

    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    pub fn signal(&self, signal: Signal) {
        rustix::process::kill_process(self.pid(), signal)
            .unwrap_or_else(|error| panic!("could not send {signal:?} to {}: {error}", self.name));
    }

    /// Waits at most `limit` for a line of stdout that contains `text`; returns the rest of that line.
    pub fn printed(&self, text: &str, limit: Duration) -> String {
        let stdout = self.stdout.as_ref().expect("stdout is read");
        let begun = Instant::now();
        loop {
            let has_ended = stdout.reader.is_finished();
            let rest = |line: &str| Some(line.split_once(text)?.1.to_owned());
            if let Some(rest) = stdout.text().lines().find_map(rest) {
                return rest;
            }
            let name = &self.name;
            assert!(!has_ended, "{name} ended before it printed {text:?}");
            assert!(begun.elapsed() < limit, "{name} did not print {text:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits at most `limit` for the end of the process.
    pub fn ended(&mut self, limit: Duration) -> ExitStatus {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("the child is ours") {
                return status;
            }
            let name = &self.name;
            assert!(
                start.elapsed() < limit,
                "{name} did not end within {limit:?}"
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits at most `limit` for the end of the process; returns its exit status and stdout.
    pub fn finish(mut self, limit: Duration) -> (ExitStatus, String) {
        let status = self.ended(limit);
        let stdout = match self.stdout.take() {
            Some(Stdout { text, reader }) => {
                reader.join().expect("the reader does not panic");
                std::mem::take(&mut *text.lock().unwrap_or_else(PoisonError::into_inner))
            }
            None => String::new(),
        };
        (status, stdout)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            let _ = rustix::process::kill_process_group(self.pid(), Signal::KILL);
            let _ = self.child.wait();
        }
        let stderr = self.stderr();
        if !stderr.is_empty() {
            eprintln!("{}:\n{stderr}", self.name);
        }
    }
}
