//! The state of a node: rates, latencies, drops by reason, and a status as text; once a second on `/diagnostics`. Each
//! subject of the watchdog has a separate status: `wm/encoder: memory`.

mod latency;
mod publishers;
mod rate;
mod watchdog;

pub use latency::Latency;
pub use watchdog::{Deadline, Input};

use crate::backend::EndpointId;
use publishers::PublishersOf;
use rate::Rate;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use watchdog::{Finding, Watchdog};
use wm_msgs::diagnostic_msgs::{DiagnosticStatus, KeyValue};

/// Subject of the condition that messages are too large.
const MESSAGE_SIZE: &str = "message size";

/// The health of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// All is well.
    Ok,
    /// It works, but needs attention.
    Warn,
    /// It does not work.
    Error,
}

impl Level {
    fn code(self) -> u8 {
        match self {
            Self::Ok => DiagnosticStatus::OK,
            Self::Warn => DiagnosticStatus::WARN,
            Self::Error => DiagnosticStatus::ERROR,
        }
    }
}

/// Counts what happens in a node. Clones count together.
#[derive(Clone, Debug)]
pub struct Diagnostics {
    state: Arc<Mutex<State>>,
}

#[derive(Debug)]
struct State {
    name: String,
    hardware_id: String,
    level: Level,
    message: String,
    received: BTreeMap<String, Rate>,
    sent: BTreeMap<String, Rate>,
    /// Total, and how many of them since the last report.
    drops: BTreeMap<String, (u64, u64)>,
    /// Inputs skipped by design.
    skips: BTreeMap<String, u64>,
    latencies: BTreeMap<String, Latency>,
    values: BTreeMap<String, String>,
    watchdog: Watchdog,
    /// Topics of the node's publishers (true) and subscriptions.
    endpoints: BTreeMap<EndpointId, (String, bool)>,
    /// By topic, the last message larger than a stock ROS 2 subscriber can receive \[byte\].
    oversized: BTreeMap<EndpointId, usize>,
}

/// The graph, as the report needs it.
pub(crate) trait Graph {
    /// The number of endpoints of other participants that this one is connected to.
    fn matched(&self, endpoint: &EndpointId) -> usize;
    /// The number of those that run another DDS implementation.
    fn foreign(&self, endpoint: &EndpointId) -> usize;
    /// Why others are not connected to this one, as text.
    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String>;
    /// The other topics on which messages of the type of this endpoint are published.
    fn published_alike(&self, endpoint: &EndpointId) -> BTreeSet<String>;
}

impl Diagnostics {
    /// `name` is the node's full name.
    pub(crate) fn new(name: &str) -> Self {
        let host = rustix::system::uname()
            .nodename()
            .to_string_lossy()
            .into_owned();
        let state = State {
            name: name.trim_start_matches('/').to_owned(),
            hardware_id: host,
            level: Level::Ok,
            message: "running".to_owned(),
            received: BTreeMap::new(),
            sent: BTreeMap::new(),
            drops: BTreeMap::new(),
            skips: BTreeMap::new(),
            latencies: BTreeMap::new(),
            values: BTreeMap::new(),
            watchdog: Watchdog::default(),
            endpoints: BTreeMap::new(),
            oversized: BTreeMap::new(),
        };
        Self {
            state: Arc::new(Mutex::new(state)),
        }
    }

    /// Counts stay whole if a thread panics between them.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a received message.
    pub fn received(&self, input: &str) {
        let mut state = self.state();
        count(&mut state.received, input);
        state.watchdog.arrived(input, Instant::now());
    }

    /// Counts a published message.
    pub fn sent(&self, output: &str) {
        count(&mut self.state().sent, output);
    }

    /// Counts a drop by reason. A drop within the last second makes the status WARN.
    pub fn count_drop(&self, reason: &str) {
        self.count_drops(reason, 1);
    }

    /// Counts several drops for the same reason.
    pub fn count_drops(&self, reason: &str, number: u64) {
        let mut state = self.state();
        match state.drops.get_mut(reason) {
            Some((total, recent)) => {
                *total += number;
                *recent += number;
            }
            None => {
                state.drops.insert(reason.to_owned(), (number, number));
            }
        }
    }

    /// Counts inputs skipped by design, for example frames that a node does not need. They are no loss, and the status
    /// stays.
    pub fn count_skipped(&self, reason: &str, number: u64) {
        let mut state = self.state();
        match state.skips.get_mut(reason) {
            Some(total) => *total += number,
            None => {
                state.skips.insert(reason.to_owned(), number);
            }
        }
    }

    /// The latency of this stage; the handle can be kept.
    pub fn latency(&self, stage: &str) -> Latency {
        let mut state = self.state();
        if let Some(latency) = state.latencies.get(stage) {
            return latency.clone();
        }
        state.latencies.entry(stage.to_owned()).or_default().clone()
    }

    /// Sets the status text, until the next call.
    pub fn set_status(&self, level: Level, message: impl Into<String>) {
        let mut state = self.state();
        state.level = level;
        state.message = message.into();
    }

    /// Sets a figure to report; the key names its unit.
    pub fn set_value(&self, key: &str, value: impl ToString) {
        self.state()
            .values
            .insert(key.to_owned(), value.to_string());
    }

    /// Names the hardware, instead of the host.
    pub fn set_hardware_id(&self, hardware_id: impl Into<String>) {
        self.state().hardware_id = hardware_id.into();
    }

    /// Watches an input from now on: WARN after three periods without it, ERROR after ten.
    pub fn expect_input(&self, input: Input) {
        self.state().watchdog.expect(input, Instant::now());
    }

    /// Counts a run of a stage with a deadline: WARN if some runs miss it, ERROR if most do.
    pub fn took(&self, deadline: Deadline, taken: Duration) {
        self.state().watchdog.took(deadline, taken);
    }

    /// Reports a fault that exists now, and its remedy. Without a further report within five seconds it counts as over.
    pub fn raise(&self, subject: &str, level: Level, message: impl Into<String>) {
        let mut state = self.state();
        state
            .watchdog
            .raise(subject, level, message.into(), Instant::now());
    }

    /// Ends all watches: an inactive node needs no input.
    pub(crate) fn stand_down(&self) {
        self.state().watchdog.stand_down();
    }

    /// Adds an endpoint to the report, which counts its connections.
    pub(crate) fn add_endpoint(&self, id: EndpointId, topic: &str, is_publisher: bool) {
        let mut state = self.state();
        state.endpoints.insert(id, (topic.to_owned(), is_publisher));
    }

    /// Removes an endpoint from the report.
    pub(crate) fn remove_endpoint(&self, id: &EndpointId) {
        let mut state = self.state();
        state.endpoints.remove(id);
        state.oversized.remove(id);
    }

    /// Reports that a publisher sends messages of `len` bytes, more than a stock ROS 2 subscriber can receive.
    pub(crate) fn oversized(&self, id: EndpointId, len: usize) {
        self.state().oversized.insert(id, len);
    }

    /// Logs which inputs are missing since the last report, and which are back.
    pub(crate) fn say_news(&self) {
        let news = self.state().watchdog.take_news();
        for Finding { level, message, .. } in news {
            match level {
                Level::Ok => tracing::info!("{message}"),
                Level::Warn | Level::Error => tracing::warn!("{message}"),
            }
        }
    }

    /// Makes the report, and starts the next second: the node's own status, then one per subject of the watchdog.
    pub(crate) fn report(&self, now: Instant, graph: &dyn Graph) -> Vec<DiagnosticStatus> {
        self.state().report(now, graph, watchdog::resident())
    }
}

fn count(rates: &mut BTreeMap<String, Rate>, name: &str) {
    match rates.get_mut(name) {
        Some(rate) => rate.count(Instant::now()),
        None => rates
            .entry(name.to_owned())
            .or_default()
            .count(Instant::now()),
    }
}

impl State {
    fn report(
        &mut self,
        now: Instant,
        graph: &dyn Graph,
        resident: Option<u64>,
    ) -> Vec<DiagnosticStatus> {
        let findings = self.findings(now, graph, resident);
        let mut values: Vec<KeyValue> = Vec::new();
        let mut add = |key: String, value: String| values.push(KeyValue { key, value });
        let mut warnings = Vec::new();
        for (direction, rates) in [("received", &mut self.received), ("sent", &mut self.sent)] {
            for (name, rate) in rates {
                add(
                    format!("{direction} {name} [Hz]"),
                    format!("{:.2}", rate.per_second(now)),
                );
                add(
                    format!("{direction} {name} [total]"),
                    rate.total().to_string(),
                );
            }
        }
        for (stage, latency) in &self.latencies {
            if let Some(summary) = latency.summary(now) {
                add(
                    format!("latency {stage} p50 [ms]"),
                    format!("{:.2}", summary.p50_ms),
                );
                add(
                    format!("latency {stage} p95 [ms]"),
                    format!("{:.2}", summary.p95_ms),
                );
                add(
                    format!("latency {stage} p99 [ms]"),
                    format!("{:.2}", summary.p99_ms),
                );
                add(
                    format!("latency {stage} [samples]"),
                    summary.samples.to_string(),
                );
            }
        }
        for (reason, (total, recent)) in &mut self.drops {
            add(format!("dropped: {reason} [total]"), total.to_string());
            if *recent > 0 {
                warnings.push(format!("dropped {recent}: {reason}"));
                *recent = 0;
            }
        }
        for (reason, total) in &self.skips {
            add(format!("skipped: {reason} [total]"), total.to_string());
        }
        for (id, (topic, is_publisher)) in &self.endpoints {
            let others = if *is_publisher {
                "subscribers"
            } else {
                "publishers"
            };
            add(
                format!("{others} of {topic}"),
                graph.matched(id).to_string(),
            );
        }
        for (key, value) in &self.values {
            add(key.clone(), value.clone());
        }
        let mut level = self.level;
        if !warnings.is_empty() {
            level = level.max(Level::Warn);
        }
        for finding in &findings {
            level = level.max(finding.level);
            if finding.level > Level::Ok {
                warnings.push(finding.message.clone());
            }
        }
        let message =
            std::iter::once(self.message.as_str()).chain(warnings.iter().map(String::as_str));
        let own = DiagnosticStatus {
            level: level.code(),
            name: self.name.clone(),
            message: message.collect::<Vec<_>>().join("; "),
            hardware_id: self.hardware_id.clone(),
            values,
        };
        let of_finding = |finding: Finding| DiagnosticStatus {
            level: finding.level.code(),
            name: format!("{}: {}", self.name, finding.subject),
            message: finding.message,
            hardware_id: self.hardware_id.clone(),
            values: Vec::new(),
        };
        std::iter::once(own)
            .chain(findings.into_iter().map(of_finding))
            .collect()
    }

    /// The findings of the watchdog, and faults of connections.
    fn findings(&mut self, now: Instant, graph: &dyn Graph, resident: Option<u64>) -> Vec<Finding> {
        let publishers = PublishersOf::new(&self.name, &self.endpoints, graph);
        let mut findings = self.watchdog.report(now, &publishers, resident);
        for (id, (topic, _)) in &self.endpoints {
            findings.extend(graph.mismatches(id).into_iter().map(|message| Finding {
                subject: format!("connections of {topic}"),
                level: Level::Warn,
                message,
            }));
            if let Some(len) = self.oversized.get(id)
                && graph.foreign(id) > 0
            {
                findings.push(Finding {
                    subject: format!("{MESSAGE_SIZE} of {topic}"),
                    level: Level::Warn,
                    message: format!(
                        "{} subscriber(s) of another DDS implementation may receive messages of {len} bytes late, or miss them by \
                         best effort: on their machine, set net.core.rmem_max and net.core.rmem_default to 4194304 (docs/networking.md)",
                        graph.foreign(id)
                    ),
                });
            }
        }
        findings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A graph in which each endpoint has two others, one of them foreign.
    pub(super) struct Pairs;

    impl Graph for Pairs {
        fn matched(&self, _: &EndpointId) -> usize {
            2
        }

        fn foreign(&self, _: &EndpointId) -> usize {
            1
        }

        fn mismatches(&self, id: &EndpointId) -> Vec<String> {
            (*id == [9; 16])
                .then(|| "incompatible reliability".to_owned())
                .into_iter()
                .collect()
        }

        fn published_alike(&self, _: &EndpointId) -> BTreeSet<String> {
            BTreeSet::from(["/front".to_owned(), "/wm/predicted".to_owned()])
        }
    }

    /// The node's own status.
    fn status(diagnostics: &Diagnostics, now: Instant) -> DiagnosticStatus {
        diagnostics.report(now, &Pairs).swap_remove(0)
    }

    fn value(status: &DiagnosticStatus, key: &str) -> Option<String> {
        status
            .values
            .iter()
            .find(|pair| pair.key == key)
            .map(|pair| pair.value.clone())
    }

    #[test]
    fn a_drop_warns_once_and_stays_in_the_total() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        let now = Instant::now();
        assert_eq!(status(&diagnostics, now).level, DiagnosticStatus::OK);
        diagnostics.count_drop("out_of_order");
        diagnostics.count_drop("out_of_order");
        let report = status(&diagnostics, now);
        assert_eq!(
            (report.level, report.message.as_str()),
            (DiagnosticStatus::WARN, "running; dropped 2: out_of_order")
        );
        let report = status(&diagnostics, now);
        assert_eq!(report.level, DiagnosticStatus::OK);
        assert_eq!(
            value(&report, "dropped: out_of_order [total]").as_deref(),
            Some("2")
        );
        assert_eq!(report.name, "wm/encoder");
        assert!(!report.hardware_id.is_empty());
    }

    #[test]
    fn what_is_left_out_by_choice_is_counted_and_does_not_warn() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics.count_skipped("pace", 1);
        diagnostics.count_skipped("pace", 2);
        let report = status(&diagnostics, Instant::now());
        assert_eq!(
            (report.level, report.message.as_str()),
            (DiagnosticStatus::OK, "running")
        );
        assert_eq!(
            value(&report, "skipped: pace [total]").as_deref(),
            Some("3")
        );
    }

    #[test]
    fn an_error_is_not_made_milder_by_a_warning() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics.set_status(Level::Error, "no weights");
        diagnostics.count_drop("late");
        assert_eq!(
            status(&diagnostics, Instant::now()).level,
            DiagnosticStatus::ERROR
        );
    }

    #[test]
    fn what_is_watched_has_a_status_of_its_own() {
        let diagnostics = Diagnostics::new("/wm/predictor");
        let input = Input::new("latents", ["/wm/latent"], "start the encoder");
        diagnostics.add_endpoint([1; 16], "/wm/latent", false);
        diagnostics.expect_input(input);
        let now = Instant::now();
        assert_eq!(status(&diagnostics, now).level, DiagnosticStatus::OK);
        diagnostics.received("/wm/latent");
        let reports = diagnostics.report(now + Duration::from_secs(9), &Pairs);
        let names: Vec<&str> = reports.iter().map(|status| status.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "wm/predictor",
                "wm/predictor: input latents",
                "wm/predictor: memory"
            ]
        );
        let [own, input, _] = &reports[..] else {
            panic!("three")
        };
        assert_eq!(
            (own.level, input.level),
            (DiagnosticStatus::ERROR, DiagnosticStatus::ERROR)
        );
        assert!(own.message.contains(&input.message), "{own:?}");
        assert!(
            input
                .message
                .contains("2 publishers are connected but silent"),
            "{input:?}"
        );
        assert_eq!(value(own, "publishers of /wm/latent").as_deref(), Some("2"));
        diagnostics.stand_down();
        let later = status(&diagnostics, now + Duration::from_secs(99));
        assert_eq!(later.level, DiagnosticStatus::OK);
    }

    #[test]
    fn connections_that_fail_or_cannot_take_the_messages_warn() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        let subjects = || -> Vec<String> {
            let reports = diagnostics.report(Instant::now(), &Pairs);
            let warned = reports.iter().skip(1).filter(|status| status.level == 1);
            warned.map(|status| status.name.clone()).collect()
        };
        diagnostics.add_endpoint([1; 16], "/wm/latent", true);
        assert_eq!(subjects(), [""; 0]);
        diagnostics.oversized([1; 16], 500_000);
        diagnostics.add_endpoint([9; 16], "/camera", false);
        assert_eq!(
            subjects(),
            [
                "wm/encoder: message size of /wm/latent",
                "wm/encoder: connections of /camera"
            ]
        );
        diagnostics.remove_endpoint(&[1; 16]);
        diagnostics.remove_endpoint(&[9; 16]);
        assert_eq!(subjects(), [""; 0]);
    }

    #[test]
    fn latencies_and_values_are_listed_with_their_units() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics
            .latency("step")
            .record(Duration::from_millis(20));
        diagnostics.set_value("queue [messages]", 3);
        let report = status(&diagnostics, Instant::now());
        assert_eq!(value(&report, "queue [messages]").as_deref(), Some("3"));
        assert!(
            value(&report, "latency step p95 [ms]")
                .unwrap()
                .starts_with("20."),
            "{report:?}"
        );
    }
}
