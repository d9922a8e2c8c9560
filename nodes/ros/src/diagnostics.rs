//! How a node fares: rates, latencies, drops by reason, and a status in words; once a second on `/diagnostics`.

mod latency;
mod rate;

pub use latency::Latency;

use rate::Rate;
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use wm_msgs::diagnostic_msgs::{DiagnosticStatus, KeyValue};

/// How well a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// All is well.
    Ok,
    /// It works, but somebody should look.
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
    latencies: BTreeMap<String, Latency>,
    values: BTreeMap<String, String>,
    /// Inputs that should keep coming: how old they may be.
    expected: BTreeMap<String, Duration>,
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
            latencies: BTreeMap::new(),
            values: BTreeMap::new(),
            expected: BTreeMap::new(),
        };
        Self {
            state: Arc::new(Mutex::new(state)),
        }
    }

    /// Counts stay whole if a thread panics between them.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts a message that came in.
    pub fn received(&self, input: &str) {
        count(&mut self.state().received, input);
    }

    /// Counts a message that went out.
    pub fn sent(&self, output: &str) {
        count(&mut self.state().sent, output);
    }

    /// Counts something lost, and why. A drop within the last second makes the status WARN.
    pub fn count_drop(&self, reason: &str) {
        self.count_drops(reason, 1);
    }

    /// Counts several things lost for the same reason.
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

    /// The latency of this stage; the handle can be kept.
    pub fn latency(&self, stage: &str) -> Latency {
        let mut state = self.state();
        if let Some(latency) = state.latencies.get(stage) {
            return latency.clone();
        }
        state.latencies.entry(stage.to_owned()).or_default().clone()
    }

    /// Says how the node is, in words, until it is said otherwise.
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

    /// Makes the status WARN while this input, once it has begun, is older than `age`.
    pub fn expect_input(&self, input: &str, age: Duration) {
        self.state().expected.insert(input.to_owned(), age);
    }

    /// The report, and the start of the next second.
    pub(crate) fn report(&self, now: Instant) -> DiagnosticStatus {
        self.state().report(now)
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
    fn report(&mut self, now: Instant) -> DiagnosticStatus {
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
        for (input, age) in &self.expected {
            let last = self.received.get(input).and_then(Rate::last);
            if let Some(silent) = last
                .map(|last| now.saturating_duration_since(last))
                .filter(|silent| silent > age)
            {
                warnings.push(format!("no {input} for {:.1} s", silent.as_secs_f64()));
            }
        }
        for (key, value) in &self.values {
            add(key.clone(), value.clone());
        }
        let level = if warnings.is_empty() {
            self.level
        } else {
            self.level.max(Level::Warn)
        };
        let message =
            std::iter::once(self.message.as_str()).chain(warnings.iter().map(String::as_str));
        DiagnosticStatus {
            level: level.code(),
            name: self.name.clone(),
            message: message.collect::<Vec<_>>().join("; "),
            hardware_id: self.hardware_id.clone(),
            values,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(diagnostics.report(now).level, DiagnosticStatus::OK);
        diagnostics.count_drop("out_of_order");
        diagnostics.count_drop("out_of_order");
        let report = diagnostics.report(now);
        assert_eq!(
            (report.level, report.message.as_str()),
            (DiagnosticStatus::WARN, "running; dropped 2: out_of_order")
        );
        let report = diagnostics.report(now);
        assert_eq!(report.level, DiagnosticStatus::OK);
        assert_eq!(
            value(&report, "dropped: out_of_order [total]").as_deref(),
            Some("2")
        );
        assert_eq!(report.name, "wm/encoder");
        assert!(!report.hardware_id.is_empty());
    }

    #[test]
    fn an_error_is_not_made_milder_by_a_warning() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics.set_status(Level::Error, "no weights");
        diagnostics.count_drop("late");
        assert_eq!(
            diagnostics.report(Instant::now()).level,
            DiagnosticStatus::ERROR
        );
    }

    #[test]
    fn an_input_that_stops_is_reported() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics.expect_input("latent", Duration::from_secs(2));
        let now = Instant::now();
        assert_eq!(
            diagnostics.report(now + Duration::from_secs(9)).level,
            DiagnosticStatus::OK,
            "it never began"
        );
        diagnostics.received("latent");
        assert_eq!(
            diagnostics.report(now + Duration::from_secs(1)).level,
            DiagnosticStatus::OK
        );
        let report = diagnostics.report(now + Duration::from_secs(9));
        assert_eq!(report.level, DiagnosticStatus::WARN);
        assert!(report.message.contains("no latent for"));
    }

    #[test]
    fn latencies_and_values_are_listed_with_their_units() {
        let diagnostics = Diagnostics::new("/wm/encoder");
        diagnostics
            .latency("step")
            .record(Duration::from_millis(20));
        diagnostics.set_value("queue [messages]", 3);
        let report = diagnostics.report(Instant::now());
        assert_eq!(value(&report, "queue [messages]").as_deref(), Some("3"));
        assert!(
            value(&report, "latency step p95 [ms]")
                .unwrap()
                .starts_with("20."),
            "{report:?}"
        );
    }
}
