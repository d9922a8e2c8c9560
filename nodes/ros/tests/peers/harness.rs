//! Other processes for a test: this very program in another role, and peers that nobody here wrote.

use std::{
    io::{BufRead as _, BufReader},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};

pub use crate::{
    fresh_domain::fresh_domain,
    participants::{PATIENCE, context, node, soon},
    ros2_peer::{peers, rclpy, root},
};

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

/// The domain and the argument of a role.
pub fn given() -> (u16, String) {
    let variable = |name| std::env::var(name).expect("started by another test");
    (
        variable("ROS_DOMAIN_ID").parse().unwrap(),
        variable("ARGUMENT"),
    )
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
