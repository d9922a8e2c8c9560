//! A program as the policy.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Mutex,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    thread,
    time::Duration,
};

use anyhow::{Context as _, Result, anyhow, bail};

use super::{protocol::Request, words::words};

/// Longest answer \[bytes\].
const MAX_LINE: u64 = 4 << 20;

/// A policy program. One process serves all trials in sequence, so that it loads an accelerator once. It starts with
/// the first request, and is killed on drop. It shares the standard error of this process.
#[derive(Debug)]
pub(crate) struct PolicyProcess {
    command: String,
    words: Vec<String>,
    limit: Duration,
    state: Mutex<State>,
}

#[derive(Debug)]
enum State {
    NotStarted,
    RunningProgram(RunningProgram),
    /// The error that ended it, and the run.
    Ended(String),
}

/// A running program.
#[derive(Debug)]
struct RunningProgram {
    child: Child,
    requests: Sender<Vec<u8>>,
    lines: Receiver<Result<String>>,
}

impl PolicyProcess {
    /// Parses a command; `limit` bounds each answer. Starts nothing yet.
    ///
    /// # Errors
    /// If the command cannot be split into words.
    pub(crate) fn new(command: &str, limit: Duration) -> Result<Self> {
        Ok(Self {
            command: command.to_owned(),
            words: words(command)?,
            limit,
            state: Mutex::new(State::NotStarted),
        })
    }

    /// The command.
    pub(super) fn command(&self) -> &str {
        &self.command
    }

    /// Sends a request and returns the answer line.
    ///
    /// # Errors
    /// If the program cannot start, has ended, or exceeds the time limit; it is then killed and not restarted.
    pub(super) fn ask(&self, request: &Request<'_>) -> Result<String> {
        let mut line = serde_json::to_vec(request)?;
        line.push(b'\n');
        let state = self.state.lock();
        let mut state =
            state.map_err(|_| anyhow!("another thread failed while it waited for an answer"))?;
        if matches!(*state, State::NotStarted) {
            *state = State::RunningProgram(RunningProgram::start(&self.words)?);
        }
        let answer = match &mut *state {
            State::RunningProgram(running) => running.ask(line, self.limit),
            // Any of several threads may report the error.
            State::Ended(error) => bail!("the program was ended after an error: {error}"),
            State::NotStarted => bail!("the program was not started"),
        };
        if let Err(error) = &answer {
            *state = State::Ended(format!("{error:#}"));
        }
        answer
    }
}

impl RunningProgram {
    fn start(words: &[String]) -> Result<Self> {
        let (program, arguments) = words.split_first().context("an empty command")?;
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("{program} cannot be started"))?;
        let stdin = child.stdin.take().context("a pipe to it")?;
        let stdout = child.stdout.take().context("a pipe from it")?;
        let (requests, to_write) = channel();
        let (read, lines) = channel();
        // Separate threads: neither a full pipe nor a silent program can exceed the time limit. They end with the pipes.
        thread::spawn(move || write(stdin, &to_write));
        thread::spawn(move || read_lines(stdout, &read));
        Ok(Self {
            child,
            requests,
            lines,
        })
    }

    fn ask(&mut self, line: Vec<u8>, limit: Duration) -> Result<String> {
        // If the program has ended, reading reports it.
        self.requests.send(line).ok();
        match self.lines.recv_timeout(limit) {
            Ok(line) => line,
            Err(RecvTimeoutError::Timeout) => bail!("no answer within {} s", limit.as_secs_f64()),
            Err(RecvTimeoutError::Disconnected) => {
                let status = self.child.try_wait().ok().flatten();
                let status = status.map_or(String::new(), |status| format!(" ({status})"));
                bail!("it ended its output{status}; its standard error is above")
            }
        }
    }
}

impl Drop for RunningProgram {
    fn drop(&mut self) {
        // Both fail only after `wait`.
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

fn write(mut stdin: ChildStdin, requests: &Receiver<Vec<u8>>) {
    for line in requests {
        if stdin.write_all(&line).and_then(|()| stdin.flush()).is_err() {
            return;
        }
    }
}

fn read_lines(stdout: ChildStdout, lines: &Sender<Result<String>>) {
    let mut stdout = BufReader::new(stdout);
    loop {
        let mut line = Vec::new();
        let read = stdout.by_ref().take(MAX_LINE).read_until(b'\n', &mut line);
        let line = match read {
            Ok(0) => return,
            Ok(_) if line.ends_with(b"\n") => {
                String::from_utf8(line).context("the answer is not UTF-8")
            }
            Ok(_) if line.len() as u64 == MAX_LINE => {
                Err(anyhow!("the answer is longer than {MAX_LINE} bytes"))
            }
            Ok(_) => Err(anyhow!("it ended within an answer")),
            Err(error) => Err(error).context("cannot read its output"),
        };
        let is_last = line.is_err();
        if lines.send(line).is_err() || is_last {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::path::Path;

    use wm_motion::actions::ActionEncoding;

    use super::*;
    use crate::policy::protocol::{ActionSpaceInfo, VERSION};

    fn ask(process: &PolicyProcess) -> Result<String> {
        let encoding = ActionEncoding::default();
        process.ask(&Request {
            version: VERSION,
            task: "a task",
            trial: 0,
            seed: 0,
            step: 0,
            instruction: "",
            // More than a pipe holds.
            image: "A".repeat(1 << 20),
            views: 1,
            state: None,
            action_space: &ActionSpaceInfo::of(&encoding),
        })
    }

    /// Id of the running process, if any.
    fn pid(process: &PolicyProcess) -> Option<u32> {
        match &*process.state.lock().unwrap() {
            State::RunningProgram(running) => Some(running.child.id()),
            State::NotStarted | State::Ended(_) => None,
        }
    }

    fn is_there(pid: u32) -> bool {
        Path::new(&format!("/proc/{pid}")).exists()
    }

    #[test]
    fn one_process_serves_all_requests_and_ends_on_drop() {
        let process = PolicyProcess::new("cat", Duration::from_secs(60)).unwrap();
        assert_eq!(pid(&process), None);
        let line = ask(&process).unwrap();
        assert!(
            line.starts_with("{\"version\":1,\"task\":\"a task\""),
            "{}",
            line.len()
        );
        let first = pid(&process).unwrap();
        ask(&process).unwrap();
        assert_eq!(pid(&process), Some(first));
        assert!(is_there(first));
        drop(process);
        assert!(!is_there(first));
    }

    #[test]
    fn silent_program_is_killed_and_not_restarted() {
        let process = PolicyProcess::new("sleep 3600", Duration::from_millis(20)).unwrap();
        let error = ask(&process).unwrap_err().to_string();
        assert!(error.contains("no answer within 0.02 s"), "{error}");
        assert_eq!(pid(&process), None);
        let error = ask(&process).unwrap_err().to_string();
        assert!(
            error.contains("ended after an error: no answer within"),
            "{error}"
        );
    }

    #[test]
    fn endless_answer_is_cut_off() {
        let process = PolicyProcess::new("cat /dev/zero", Duration::from_secs(60)).unwrap();
        let error = ask(&process).unwrap_err().to_string();
        assert!(error.contains("longer than"), "{error}");
    }
}
