//! Decides when to start, stop and give up on processes, without processes, clock or signals.
//!
//! The runner reports [`Event`]s and executes the resulting [`Order`]s. A stop begins with SIGINT to every process. A
//! process that still runs after its `sigterm_timeout` gets SIGTERM, and after its `sigkill_timeout` SIGKILL. A second
//! request to stop skips the wait. Services, such as a router, are stopped once all other processes have ended.

use super::plan::Process;
use std::fmt;
use std::time::Duration;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// With this exit code.
    Code(i32),
    /// By this signal.
    Signal(i32),
    NotStarted,
}

impl fmt::Display for Exit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => write!(formatter, "exit code {code}"),
            Self::Signal(9) => write!(formatter, "signal 9 (SIGKILL)"),
            Self::Signal(6) => write!(formatter, "signal 6 (SIGABRT)"),
            Self::Signal(11) => write!(formatter, "signal 11 (SIGSEGV)"),
            Self::Signal(signal) => write!(formatter, "signal {signal}"),
            Self::NotStarted => write!(formatter, "could not be started"),
        }
    }
}

/// The exit code of programs of this suite that finished but lost data.
pub(crate) const DATA_LOSS: i32 = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// Process `.0` ended.
    Ended(usize, Exit),
    /// The timer of process `.0`, armed in step `.1`, ran out.
    TimerElapsed(usize, Step),
    /// The user or the system requests a stop.
    StopRequested,
}

/// The state of a process; timers are armed for a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Step {
    /// Not started, or waiting for a restart.
    Waiting,
    Running,
    /// Received SIGINT.
    Interrupted,
    /// Received SIGTERM.
    Terminated,
    /// Received SIGKILL.
    Killed,
    Ended,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StopSignal {
    Interrupt,
    Terminate,
    Kill,
}

/// An action of the runner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// Start process `.0`.
    Start(usize),
    /// Send process `.0` a signal.
    Send(usize, StopSignal),
    /// Report [`Event::TimerElapsed`] for process `.0` and step `.1` after `.2`.
    ArmTimer(usize, Step, Duration),
    /// Print a message.
    Say(String),
}

/// The state of a launch.
#[derive(Debug)]
pub(crate) struct Supervisor {
    processes: Vec<(Process, State)>,
    is_stopping: bool,
    failures: Vec<String>,
    lost_data: Vec<String>,
}

#[derive(Debug)]
struct State {
    step: Step,
    restarts: u32,
}

/// The result of a launch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// One sentence per failed process.
    pub failures: Vec<String>,
    /// One sentence per process that lost data.
    pub lost_data: Vec<String>,
}

impl Outcome {
    /// 0; 1 if a process failed; 3 if one lost data.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match (self.failures.is_empty(), self.lost_data.is_empty()) {
            (true, true) => 0,
            (true, false) => 3,
            (false, _) => 1,
        }
    }
}

impl Supervisor {
    /// A launch of `processes`, and the orders that start them.
    #[must_use]
    pub(crate) fn new(processes: Vec<Process>) -> (Self, Vec<Order>) {
        let orders = (0..processes.len()).map(Order::Start).collect();
        let running = |process| {
            (
                process,
                State {
                    step: Step::Running,
                    restarts: 0,
                },
            )
        };
        let processes = processes.into_iter().map(running).collect();
        (
            Self {
                processes,
                is_stopping: false,
                failures: Vec::new(),
                lost_data: Vec::new(),
            },
            orders,
        )
    }

    #[must_use]
    pub(crate) fn process(&self, index: usize) -> Option<&Process> {
        self.processes.get(index).map(|(process, _)| process)
    }

    /// How many processes run or will be restarted.
    #[must_use]
    pub(crate) fn alive(&self) -> usize {
        self.processes
            .iter()
            .filter(|(_, state)| state.step != Step::Ended)
            .count()
    }

    /// Handles `event`, and returns the resulting orders.
    pub(crate) fn on_event(&mut self, event: Event) -> Vec<Order> {
        match event {
            Event::Ended(index, exit) => self.on_ended(index, exit),
            Event::TimerElapsed(index, step) => self.on_timer(index, step),
            Event::StopRequested => self.stop(),
        }
    }

    /// The result, once all processes have ended.
    #[must_use]
    pub(crate) fn outcome(&self) -> Outcome {
        Outcome {
            failures: self.failures.clone(),
            lost_data: self.lost_data.clone(),
        }
    }

    fn on_ended(&mut self, index: usize, exit: Exit) -> Vec<Order> {
        let mut orders = self.on_exit(index, exit);
        if !self.has_users() {
            orders.extend(self.stop_services());
        }
        orders
    }

    fn on_exit(&mut self, index: usize, exit: Exit) -> Vec<Order> {
        let Some((process, state)) = self.processes.get_mut(index) else {
            return Vec::new();
        };
        let step = std::mem::replace(&mut state.step, Step::Ended);
        let name = process.name.clone();
        // an end by our own signal is not a failure, unless it took SIGKILL
        let was_asked = matches!(
            (step, exit),
            (
                Step::Interrupted | Step::Terminated | Step::Killed,
                Exit::Signal(2 | 15)
            )
        );
        let problem = match exit {
            Exit::Code(0) => None,
            Exit::Code(DATA_LOSS) => {
                self.lost_data.push(name.clone());
                Some(format!(
                    "{name} finished, but lost data (exit code {DATA_LOSS})"
                ))
            }
            _ if was_asked => None,
            _ if step == Step::Killed => Some(format!(
                "{name} did not stop on SIGINT or SIGTERM and was killed"
            )),
            _ => Some(format!("{name} failed: {exit}")),
        };
        let mut orders = Vec::new();
        match &problem {
            Some(problem) => {
                orders.push(Order::Say(problem.clone()));
                if exit != Exit::Code(DATA_LOSS) {
                    self.failures.push(problem.clone());
                }
            }
            None if step == Step::Running => orders.push(Order::Say(format!("{name} finished"))),
            None => {}
        }
        if self.is_stopping {
            return orders;
        }
        if let Some(respawn) = process.respawn {
            let is_left = respawn.max_retries.is_none_or(|most| state.restarts < most);
            if is_left {
                state.restarts += 1;
                state.step = Step::Waiting;
                orders.push(Order::Say(format!(
                    "restarting {name} (no. {})",
                    state.restarts
                )));
                orders.push(Order::ArmTimer(index, Step::Waiting, respawn.delay));
                return orders;
            }
            orders.push(Order::Say(format!(
                "not restarting {name}: all {} restart(s) are used up",
                state.restarts
            )));
        }
        if process.ends_launch {
            orders.push(Order::Say(format!(
                "{name} has ended and ends the launch: stopping the others"
            )));
            orders.extend(self.stop());
        }
        orders
    }

    fn on_timer(&mut self, index: usize, step: Step) -> Vec<Order> {
        let Some((_, state)) = self.processes.get_mut(index) else {
            return Vec::new();
        };
        // the timer's step is over
        if state.step != step {
            return Vec::new();
        }
        match step {
            Step::Waiting => {
                state.step = Step::Running;
                vec![Order::Start(index)]
            }
            Step::Interrupted | Step::Terminated => self.escalate(index),
            Step::Running | Step::Killed | Step::Ended => Vec::new(),
        }
    }

    fn stop(&mut self) -> Vec<Order> {
        self.is_stopping = true;
        let has_users = self.has_users();
        let is_due = |supervisor: &Self, index: usize| {
            let process = supervisor.process(index);
            !(has_users && process.is_some_and(|process| process.is_service))
        };
        let mut orders = Vec::new();
        for index in 0..self.processes.len() {
            if is_due(self, index) {
                orders.extend(self.escalate(index));
            }
        }
        // the others may all have been waiting for a restart
        if has_users && !self.has_users() {
            orders.extend(self.stop_services());
        }
        orders
    }

    /// Whether processes other than services run or will be restarted.
    fn has_users(&self) -> bool {
        let is_user =
            |(process, state): &(Process, State)| !process.is_service && state.step != Step::Ended;
        self.processes.iter().any(is_user)
    }

    /// Begins to stop the services.
    fn stop_services(&mut self) -> Vec<Order> {
        self.is_stopping = true;
        let is_due = |(process, state): &(Process, State)| {
            process.is_service && matches!(state.step, Step::Waiting | Step::Running)
        };
        let due: Vec<bool> = self.processes.iter().map(is_due).collect();
        let due = due.iter().enumerate().filter(|(_, is_due)| **is_due);
        due.flat_map(|(index, _)| self.escalate(index)).collect()
    }

    /// Takes the next step of stopping process `index`.
    fn escalate(&mut self, index: usize) -> Vec<Order> {
        let Some((process, state)) = self.processes.get_mut(index) else {
            return Vec::new();
        };
        match state.step {
            Step::Waiting => {
                state.step = Step::Ended;
                Vec::new()
            }
            Step::Running => {
                state.step = Step::Interrupted;
                vec![
                    Order::Send(index, StopSignal::Interrupt),
                    Order::ArmTimer(index, Step::Interrupted, process.sigterm_timeout),
                ]
            }
            Step::Interrupted => {
                state.step = Step::Terminated;
                vec![
                    Order::Say(format!(
                        "{} is still running after SIGINT: sending SIGTERM",
                        process.name
                    )),
                    Order::Send(index, StopSignal::Terminate),
                    Order::ArmTimer(index, Step::Terminated, process.sigkill_timeout),
                ]
            }
            Step::Terminated => {
                state.step = Step::Killed;
                vec![
                    Order::Say(format!(
                        "{} is still running after SIGTERM: sending SIGKILL",
                        process.name
                    )),
                    Order::Send(index, StopSignal::Kill),
                ]
            }
            Step::Killed | Step::Ended => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Output, Program, Respawn};

    fn process(name: &str) -> Process {
        Process {
            name: name.to_owned(),
            node: None,
            prefix: Vec::new(),
            program: Program::Own,
            arguments: Vec::new(),
            environment: Vec::new(),
            working_directory: None,
            output: Output::Screen,
            respawn: None,
            ends_launch: false,
            is_service: false,
            sigterm_timeout: Duration::from_secs(5),
            sigkill_timeout: Duration::from_secs(4),
        }
    }

    fn signals(orders: &[Order]) -> Vec<(usize, StopSignal)> {
        let signal = |order: &Order| match order {
            Order::Send(index, signal) => Some((*index, *signal)),
            _ => None,
        };
        orders.iter().filter_map(signal).collect()
    }

    #[test]
    fn end_of_the_player_stops_the_others_cleanly() {
        let player = Process {
            ends_launch: true,
            ..process("player-1")
        };
        let (mut supervisor, orders) = Supervisor::new(vec![player, process("encoder-2")]);
        assert_eq!(orders, [Order::Start(0), Order::Start(1)]);
        let orders = supervisor.on_event(Event::Ended(0, Exit::Code(0)));
        assert_eq!(signals(&orders), [(1, StopSignal::Interrupt)]);
        supervisor.on_event(Event::Ended(1, Exit::Code(0)));
        assert_eq!(
            (supervisor.alive(), supervisor.outcome().exit_code()),
            (0, 0)
        );
    }

    #[test]
    fn killed_node_is_a_named_failure_and_others_continue() {
        let (mut supervisor, _) = Supervisor::new(vec![process("encoder-1"), process("decoder-2")]);
        let orders = supervisor.on_event(Event::Ended(0, Exit::Signal(9)));
        assert!(signals(&orders).is_empty());
        assert_eq!(supervisor.alive(), 1);
        supervisor.on_event(Event::StopRequested);
        supervisor.on_event(Event::Ended(1, Exit::Signal(2)));
        let outcome = supervisor.outcome();
        assert_eq!(outcome.exit_code(), 1);
        assert_eq!(outcome.failures, ["encoder-1 failed: signal 9 (SIGKILL)"]);
    }

    #[test]
    fn node_that_ignores_signals_is_killed_step_by_step() {
        let (mut supervisor, _) = Supervisor::new(vec![process("stuck-1")]);
        let orders = supervisor.on_event(Event::StopRequested);
        assert!(orders.contains(&Order::ArmTimer(
            0,
            Step::Interrupted,
            Duration::from_secs(5)
        )));
        let orders = supervisor.on_event(Event::TimerElapsed(0, Step::Interrupted));
        assert_eq!(signals(&orders), [(0, StopSignal::Terminate)]);
        assert!(
            supervisor
                .on_event(Event::TimerElapsed(0, Step::Interrupted))
                .is_empty()
        );
        let orders = supervisor.on_event(Event::TimerElapsed(0, Step::Terminated));
        assert_eq!(signals(&orders), [(0, StopSignal::Kill)]);
        supervisor.on_event(Event::Ended(0, Exit::Signal(9)));
        assert_eq!(
            supervisor.outcome().failures,
            ["stuck-1 did not stop on SIGINT or SIGTERM and was killed"]
        );
    }

    #[test]
    fn second_stop_request_skips_the_wait() {
        let (mut supervisor, _) = Supervisor::new(vec![process("slow-1")]);
        supervisor.on_event(Event::StopRequested);
        assert_eq!(
            signals(&supervisor.on_event(Event::StopRequested)),
            [(0, StopSignal::Terminate)]
        );
        assert_eq!(
            signals(&supervisor.on_event(Event::StopRequested)),
            [(0, StopSignal::Kill)]
        );
    }

    #[test]
    fn restarts_are_opt_in_and_limited() {
        let respawn = Respawn {
            delay: Duration::from_millis(10),
            max_retries: Some(1),
        };
        let (mut supervisor, _) = Supervisor::new(vec![Process {
            respawn: Some(respawn),
            ..process("a-1")
        }]);
        let orders = supervisor.on_event(Event::Ended(0, Exit::Code(1)));
        assert!(orders.contains(&Order::ArmTimer(0, Step::Waiting, respawn.delay)));
        assert_eq!(
            supervisor.on_event(Event::TimerElapsed(0, Step::Waiting)),
            [Order::Start(0)]
        );
        supervisor.on_event(Event::Ended(0, Exit::Code(1)));
        assert_eq!(
            (supervisor.alive(), supervisor.outcome().exit_code()),
            (0, 1)
        );
    }

    #[test]
    fn stop_cancels_a_pending_restart() {
        let respawn = Respawn {
            delay: Duration::from_secs(1),
            max_retries: None,
        };
        let (mut supervisor, _) = Supervisor::new(vec![Process {
            respawn: Some(respawn),
            ..process("a-1")
        }]);
        supervisor.on_event(Event::Ended(0, Exit::Code(0)));
        supervisor.on_event(Event::StopRequested);
        assert_eq!(supervisor.alive(), 0);
        assert!(
            supervisor
                .on_event(Event::TimerElapsed(0, Step::Waiting))
                .is_empty()
        );
    }

    #[test]
    fn lost_data_is_its_own_exit_code() {
        let (mut supervisor, _) = Supervisor::new(vec![process("recorder-1")]);
        supervisor.on_event(Event::StopRequested);
        supervisor.on_event(Event::Ended(0, Exit::Code(DATA_LOSS)));
        assert_eq!(supervisor.outcome().exit_code(), 3);
    }
    fn with_service() -> Supervisor {
        let service = Process {
            is_service: true,
            ..process("zenoh-router")
        };
        Supervisor::new(vec![service, process("a-1"), process("b-2")]).0
    }

    #[test]
    fn service_ends_after_the_others() {
        let mut supervisor = with_service();
        let first = [(1, StopSignal::Interrupt), (2, StopSignal::Interrupt)];
        assert_eq!(signals(&supervisor.on_event(Event::StopRequested)), first);
        assert_eq!(
            signals(&supervisor.on_event(Event::Ended(1, Exit::Code(0)))),
            []
        );
        let last = signals(&supervisor.on_event(Event::Ended(2, Exit::Code(0))));
        assert_eq!(last, [(0, StopSignal::Interrupt)]);
        supervisor.on_event(Event::Ended(0, Exit::Code(0)));
        let outcome = supervisor.outcome().exit_code();
        assert_eq!((supervisor.alive(), outcome), (0, 0));
    }

    #[test]
    fn service_does_not_keep_a_finished_launch_alive() {
        let mut supervisor = with_service();
        supervisor.on_event(Event::Ended(1, Exit::Code(0)));
        let last = signals(&supervisor.on_event(Event::Ended(2, Exit::Code(1))));
        assert_eq!(last, [(0, StopSignal::Interrupt)]);
    }

    #[test]
    fn ended_service_is_a_failure_and_the_others_continue() {
        let mut supervisor = with_service();
        let orders = supervisor.on_event(Event::Ended(0, Exit::Code(1)));
        assert_eq!((signals(&orders), supervisor.alive()), (Vec::new(), 2));
        assert_eq!(supervisor.outcome().failures.len(), 1);
    }
}
