//! Runs a plan: starts its processes, prints their lines, and stops them.
//!
//! Every process leads its own process group. So Ctrl-C reaches it once, from here, and its children stop with it. The
//! kernel sends it SIGTERM if this launcher dies.

use super::{
    console::{Console, Stream},
    plan::{Output, Plan, Process, Program},
    supervisor::{Event, Exit, Order, Outcome, StopSignal, Supervisor},
};
use rustix::process::{Pid, Signal, kill_process_group, set_parent_process_death_signal};
use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::os::unix::process::ExitStatusExt as _;
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tokio::io::{AsyncBufReadExt as _, AsyncRead, BufReader};
use tokio::net::TcpStream;
use tokio::process::{Child, Command};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use wm_ros::logging::{self, Unblocked};

/// Longer lines are split into pieces of this many bytes.
const LINE_LIMIT: usize = 16 * 1024;

/// How long to wait for the last lines of an ended process. They arrive at once, unless one of its children holds its
/// streams open.
const LAST_LINES: Duration = Duration::from_millis(500);

/// How long the other processes wait for the router; they also run without it.
const ROUTER_START: Duration = Duration::from_secs(5);
const ROUTER_POLL: Duration = Duration::from_millis(10);

/// The most lines that wait for the screen; then the processes wait.
const LINES_WAITING: usize = 1024;

enum Report {
    Line(usize, Stream, String),
    Event(Event),
}

/// Runs the plan until all its processes are gone. Needs a tokio runtime on the current thread: the kernel binds the
/// parent-death signal of a child to the thread that started it.
///
/// # Errors
/// Signals cannot be received. The outcome contains failures of processes.
pub async fn run(plan: Plan) -> io::Result<Outcome> {
    let console = Console::new(logging::stdout(), logging::stderr(), terminal_columns());
    let (reports, mut inbox) = mpsc::channel(LINES_WAITING);
    let mut launch = Launch {
        console,
        reports,
        groups: HashMap::new(),
        is_screen_gone: false,
    };
    for warning in &plan.warnings {
        launch.say(&format!("warning: {warning}"));
    }
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = signal(SignalKind::hangup())?;
    let (services, addresses) = match plan.router {
        Some(router) => (vec![router.process], router.addresses),
        None => (Vec::new(), Vec::new()),
    };
    let processes = services.into_iter().chain(plan.processes).collect();
    let (mut supervisor, orders) = Supervisor::new(processes);
    let (first, others) = orders.into_iter().partition(|order| {
        let process = match order {
            Order::Start(index) => supervisor.process(*index),
            _ => None,
        };
        process.is_some_and(|process| process.is_service)
    });
    launch.carry_out(&mut supervisor, first);
    // meanwhile the router's lines wait
    let answer = tokio::time::timeout(ROUTER_START, answer_of(&addresses)).await;
    if answer.is_err() {
        launch.say(&format!(
            "the router does not answer after {ROUTER_START:?}"
        ));
    }
    launch.carry_out(&mut supervisor, others);
    while supervisor.alive() > 0 {
        let event = tokio::select! {
            Some(report) = inbox.recv() => match report {
                Report::Event(event) => Some(event),
                Report::Line(index, stream, text) => {
                    let written = launch.line(supervisor.process(index), stream, &text);
                    // the screen is gone (a closed pipe): stop
                    written.is_err().then_some(Event::StopRequested).filter(|_| launch.lost_screen())
                }
            },
            _ = interrupt.recv() => { launch.say("stopping (SIGINT)"); Some(Event::StopRequested) }
            _ = terminate.recv() => { launch.say("stopping (SIGTERM)"); Some(Event::StopRequested) }
            _ = hangup.recv() => { launch.say("stopping (SIGHUP)"); Some(Event::StopRequested) }
        };
        if let Some(event) = event {
            let orders = supervisor.on_event(event);
            launch.carry_out(&mut supervisor, orders);
        }
    }
    launch.console.finish().ok();
    let outcome = supervisor.outcome();
    for failure in &outcome.failures {
        launch.say(&format!("FAILED: {failure}"));
    }
    logging::flush();
    Ok(outcome)
}

/// Waits until one of the addresses accepts connections.
async fn answer_of(addresses: &[SocketAddr]) {
    loop {
        if addresses.is_empty() || TcpStream::connect(addresses).await.is_ok() {
            return;
        }
        tokio::time::sleep(ROUTER_POLL).await;
    }
}

fn terminal_columns() -> Option<usize> {
    rustix::termios::tcgetwinsize(io::stderr())
        .ok()
        .map(|size| usize::from(size.ws_col))
        .filter(|columns| *columns > 0)
}

struct Launch {
    console: Console<Unblocked, Unblocked>,
    reports: mpsc::Sender<Report>,
    /// The process groups of live processes.
    groups: HashMap<usize, Pid>,
    is_screen_gone: bool,
}

impl Launch {
    /// Without a screen the launcher still stops its processes; its messages are then lost.
    fn say(&mut self, text: &str) {
        self.console.print_own(text).ok();
    }

    fn line(&mut self, process: Option<&Process>, stream: Stream, text: &str) -> io::Result<()> {
        let Some(process) = process.filter(|_| !self.is_screen_gone) else {
            return Ok(());
        };
        if process.output == Output::Log && stream == Stream::Out {
            return Ok(());
        }
        self.console
            .line(&process.name, stream, text, Instant::now())
    }

    /// Whether the loss of the screen is new.
    fn lost_screen(&mut self) -> bool {
        !std::mem::replace(&mut self.is_screen_gone, true)
    }

    fn carry_out(&mut self, supervisor: &mut Supervisor, orders: Vec<Order>) {
        let mut waiting: std::collections::VecDeque<Order> = orders.into();
        while let Some(order) = waiting.pop_front() {
            match order {
                Order::Say(text) => self.say(&text),
                Order::Start(index) => {
                    let Some(process) = supervisor.process(index) else {
                        continue;
                    };
                    let started = start(process);
                    match started {
                        Ok(child) => self.watch(index, child),
                        Err(error) => {
                            let text = format!("cannot start {}: {error}", process.name);
                            self.say(&text);
                            waiting
                                .extend(supervisor.on_event(Event::Ended(index, Exit::NotStarted)));
                        }
                    }
                }
                Order::Send(index, stop_signal) => {
                    let Some(group) = self.groups.get(&index) else {
                        continue;
                    };
                    let signal = match stop_signal {
                        StopSignal::Interrupt => Signal::INT,
                        StopSignal::Terminate => Signal::TERM,
                        StopSignal::Kill => Signal::KILL,
                    };
                    // it fails only if the process is gone already
                    kill_process_group(*group, signal).ok();
                }
                Order::ArmTimer(index, step, after) => {
                    let reports = self.reports.clone();
                    tokio::spawn(async move {
                        tokio::time::sleep(after).await;
                        reports
                            .send(Report::Event(Event::TimerElapsed(index, step)))
                            .await
                            .ok();
                    });
                }
            }
        }
    }

    /// Reports the lines and the end of `child`.
    fn watch(&mut self, index: usize, mut child: Child) {
        let group = child
            .id()
            .and_then(|id| i32::try_from(id).ok())
            .and_then(Pid::from_raw);
        match group {
            Some(group) => self.groups.insert(index, group),
            None => self.groups.remove(&index),
        };
        let out = child
            .stdout
            .take()
            .map(|stream| forward(self.reports.clone(), index, Stream::Out, stream));
        let err = child
            .stderr
            .take()
            .map(|stream| forward(self.reports.clone(), index, Stream::Err, stream));
        let reports = self.reports.clone();
        tokio::spawn(async move {
            let exit = child.wait().await.map_or(Exit::NotStarted, exit_of);
            // kills its remaining children, for example background jobs of a shell
            if let Some(group) = group {
                kill_process_group(group, Signal::KILL).ok();
            }
            let last_lines = async {
                for reader in [out, err].into_iter().flatten() {
                    reader.await.ok();
                }
            };
            tokio::time::timeout(LAST_LINES, last_lines).await.ok();
            reports
                .send(Report::Event(Event::Ended(index, exit)))
                .await
                .ok();
        });
    }
}

fn start(process: &Process) -> io::Result<Child> {
    let program = match &process.program {
        Program::Own => std::env::current_exe()?,
        Program::Path(path) => path.clone(),
    };
    let mut command = match process.prefix.split_first() {
        None => Command::new(program),
        Some((first, rest)) => {
            let mut command = Command::new(first);
            command.args(rest).arg(program);
            command
        }
    };
    command
        .args(&process.arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command.process_group(0);
    for (name, value) in &process.environment {
        match value {
            Some(value) => command.env(name, value),
            None => command.env_remove(name),
        };
    }
    if let Some(directory) = &process.working_directory {
        command.current_dir(directory);
    }
    let launcher = rustix::process::getpid();
    let tie_to_launcher = move || {
        set_parent_process_death_signal(Some(Signal::TERM))?;
        // if the launcher died before that call, no signal would ever arrive
        if rustix::process::getppid() == Some(launcher) {
            Ok(())
        } else {
            Err(io::ErrorKind::NotConnected.into())
        }
    };
    // SAFETY: between fork and exec the closure only makes two system calls (prctl, getppid); it allocates nothing and
    // takes no lock.
    unsafe { command.pre_exec(tie_to_launcher) };
    command.spawn()
}

fn exit_of(status: ExitStatus) -> Exit {
    match (status.code(), status.signal()) {
        (Some(code), _) => Exit::Code(code),
        // a process without an exit code ended by a signal
        (None, signal) => Exit::Signal(signal.unwrap_or_default()),
    }
}

fn forward(
    reports: mpsc::Sender<Report>,
    index: usize,
    stream: Stream,
    source: impl AsyncRead + Unpin + Send + 'static,
) -> tokio::task::JoinHandle<()> {
    tokio::spawn(async move {
        let mut source = BufReader::with_capacity(LINE_LIMIT, source);
        while let Ok(Some(line)) = next_line(&mut source).await {
            if reports
                .send(Report::Line(index, stream, line))
                .await
                .is_err()
            {
                break;
            }
        }
    })
}

/// The next line without its end, or the next [`LINE_LIMIT`] bytes of it; `None` at the end.
async fn next_line(
    source: &mut (impl tokio::io::AsyncBufRead + Unpin),
) -> io::Result<Option<String>> {
    let mut line = Vec::new();
    loop {
        let available = source.fill_buf().await?;
        if available.is_empty() {
            return Ok((!line.is_empty()).then(|| String::from_utf8_lossy(&line).into_owned()));
        }
        let room = LINE_LIMIT - line.len();
        let end = available.iter().take(room).position(|byte| *byte == b'\n');
        // without a line end, as much as there is room
        let taken = end.unwrap_or(available.len().min(room));
        line.extend(available.iter().take(taken));
        source.consume(taken + usize::from(end.is_some()));
        if end.is_some() || line.len() >= LINE_LIMIT {
            return Ok(Some(String::from_utf8_lossy(&line).into_owned()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block_on<T>(future: impl Future<Output = T>) -> T {
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .unwrap()
            .block_on(future)
    }

    #[test]
    fn lines_are_split_and_bounded() {
        block_on(async {
            let text = format!("one\n\n{}\nlast", "x".repeat(LINE_LIMIT + 5));
            let mut source = BufReader::new(text.as_bytes());
            let mut lengths = Vec::new();
            while let Some(line) = next_line(&mut source).await.unwrap() {
                lengths.push(line.len());
            }
            assert_eq!(lengths, [3, 0, LINE_LIMIT, 5, 4]);
        });
    }

    fn plan(processes: &[&str]) -> Plan {
        use crate::{file::LaunchFile, plan::System};
        let text = format!("launch:\n{}", processes.concat());
        let file = LaunchFile::parse(std::path::Path::new("t.launch.yaml"), &text).unwrap();
        Plan::resolve(&file, &Default::default(), &System).unwrap()
    }

    fn pipe(folder: &std::path::Path, name: &str) -> std::path::PathBuf {
        let path = folder.join(name);
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&path)
                .status()
                .unwrap()
                .success()
        );
        path
    }

    #[test]
    fn processes_and_their_children_end_with_the_launch() {
        let folder = tempfile::tempdir().unwrap();
        let (started, held) = (pipe(folder.path(), "started"), pipe(folder.path(), "held"));
        // The first process ends, and ends the launch, once the second one's background job runs. That job ignores
        // SIGINT, like background jobs of a shell, and holds `held` open while it lives.
        let first = format!("read x < {}", started.display());
        let second = format!(
            "exec 3> {}; sleep 1000 & echo x > {}; wait",
            held.display(),
            started.display()
        );
        let entry = |name, script: &str, more| {
            format!("- executable: {{cmd: \"sh -c '{script}'\", name: {name}{more}}}\n")
        };
        let plan = plan(&[
            &entry("first", &first, ", on_exit: shutdown"),
            &entry("second", &second, ""),
        ]);
        let all_gone = std::thread::spawn(move || std::fs::read(held).unwrap());
        let outcome = block_on(run(plan)).unwrap();
        assert_eq!(
            outcome,
            Outcome {
                failures: Vec::new(),
                lost_data: Vec::new()
            }
        );
        assert!(all_gone.join().unwrap().is_empty());
    }

    #[test]
    fn missing_program_is_a_named_failure() {
        let outcome = block_on(run(plan(&[
            "- executable: {cmd: /no/such/program, name: ghost}\n",
        ])))
        .unwrap();
        assert_eq!(outcome.failures, ["ghost-1 failed: could not be started"]);
        assert_eq!(outcome.exit_code(), 1);
    }
}
