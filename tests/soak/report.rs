//! The report of a run.

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use serde_json::{Value, json};

use crate::{
    balance::{Balance, Totals},
    fault::Kind,
    watch::{Motion, Watch},
};

/// The least number of rounds for a judgement of memory.
const LONG_RUN: usize = 60;
/// The largest ratio of memory in the second half to that in the first.
const MOST_GROWTH: f64 = 1.15;

/// One fault.
#[derive(Debug)]
pub struct Round {
    kind: Kind,
    /// Since the beginning of the run.
    at: Duration,
    /// The commanded and the actual motion of the arm.
    pub motion: Option<Motion>,
    /// Why there is no motion to judge.
    pub problem: Option<String>,
    /// The executor's reason at the end of the fault.
    pub reason: String,
    /// Processes that had ended.
    pub deaths: Vec<&'static str>,
}

impl Round {
    /// A fault that has not begun.
    pub fn new(kind: Kind, at: Duration) -> Self {
        Self {
            kind,
            at,
            motion: None,
            problem: None,
            reason: String::new(),
            deaths: Vec::new(),
        }
    }

    /// How long the arm was commanded to move; without commands, how long it moved.
    fn seconds(&self) -> Option<f64> {
        let motion = self.motion?;
        Some(match self.kind {
            Kind::Cut | Kind::KillExecutor | Kind::StopExecutor => motion.moved_s,
            _ => motion.commanded_s,
        })
    }

    fn is_exceeded(&self) -> bool {
        self.seconds()
            .is_some_and(|seconds| seconds > self.kind.limit().as_secs_f64())
    }

    fn json(&self) -> Value {
        let motion = self.motion.unwrap_or_default();
        json!({
            "kind": self.kind.name(),
            "at_s": self.at.as_secs_f64(),
            "commanded_m": motion.commanded_m,
            "commanded_s": motion.commanded_s,
            "moved_m": motion.moved_m,
            "moved_s": motion.moved_s,
            "is_exceeded": self.is_exceeded(),
            "problem": self.problem,
            "reason": self.reason,
            "deaths": self.deaths,
        })
    }
}

impl fmt::Display for Round {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (at, name) = (self.at.as_secs(), self.kind.name());
        write!(f, "{at:>5} s  {name:<20}")?;
        match (&self.motion, &self.problem) {
            (Some(motion), _) => write!(
                f,
                "commanded {:.3} m for {:.2} s, moved {:.3} m for {:.2} s{}  {}",
                motion.commanded_m,
                motion.commanded_s,
                motion.moved_m,
                motion.moved_s,
                if self.is_exceeded() { "  TOO LONG" } else { "" },
                self.reason
            )?,
            (None, problem) => write!(f, "{}", problem.as_deref().unwrap_or_default())?,
        }
        if !self.deaths.is_empty() {
            write!(f, "  ended: {}", self.deaths.join(", "))?;
        }
        Ok(())
    }
}

/// All rounds; written after each, so that an interrupted run has a report too.
pub struct Report {
    folder: PathBuf,
    seed: u64,
    rounds: Vec<Round>,
    /// Resident memory of each process after each round: time \[s\] and size \[MiB\].
    memory: BTreeMap<String, Vec<(f64, f64)>>,
    totals: Totals,
    balance: Balance,
}

impl Report {
    pub fn new(folder: &Path, seed: u64) -> Self {
        Self {
            folder: folder.to_owned(),
            seed,
            rounds: Vec::new(),
            memory: BTreeMap::new(),
            totals: BTreeMap::new(),
            balance: Balance::new(),
        }
    }

    /// Adds a round and the state after it.
    pub fn add(
        &mut self,
        round: Round,
        at: Duration,
        watch: &Watch,
        resident: BTreeMap<String, f64>,
    ) {
        for (name, mib) in resident {
            let of_process = self.memory.entry(name).or_default();
            of_process.push((round.at.as_secs_f64(), mib));
        }
        self.totals = watch.totals();
        self.balance
            .add(at, round.kind, &round.deaths, &self.totals);
        self.rounds.push(round);
        self.write();
    }

    /// Prints the tables. Returns whether the arm kept its limits in every round, all losses were counted, and memory
    /// did not grow.
    pub fn finish(&self) -> bool {
        println!("{}", self.markdown());
        let growing: Vec<_> = self.growing().collect();
        if !growing.is_empty() {
            println!("memory grows: {}", growing.join(", "));
        }
        let is_in_time = !self.rounds.iter().any(Round::is_exceeded);
        is_in_time && self.balance.is_kept() && growing.is_empty()
    }

    /// Nodes that need clearly more memory in the second half of the run. Processes of a restarted node are judged
    /// together.
    fn growing(&self) -> impl Iterator<Item = &str> {
        let end = self
            .rounds
            .last()
            .map_or(0.0, |round| round.at.as_secs_f64());
        let mut most: BTreeMap<&str, [f64; 2]> = BTreeMap::new();
        for (process, sizes) in &self.memory {
            let node = process.split(' ').next().unwrap_or(process);
            let halves = most.entry(node).or_default();
            for (at, mib) in sizes {
                let half = &mut halves[usize::from(*at > end / 2.0)];
                *half = half.max(*mib);
            }
        }
        let is_long = self.rounds.len() >= LONG_RUN;
        let most = most.into_iter().filter(move |_| is_long);
        most.filter(|(_, [first, second])| *second > first * MOST_GROWTH)
            .map(|(node, _)| node)
    }

    fn write(&self) {
        let rounds: Vec<Value> = self.rounds.iter().map(Round::json).collect();
        let report = json!({
            "seed": self.seed,
            "rounds": rounds,
            "totals": self.totals,
            "balance": self.balance.json(),
            "memory_mib": self.memory,
        });
        let text = serde_json::to_string_pretty(&report).expect("JSON");
        std::fs::write(self.folder.join("soak.json"), text).expect("the report");
        std::fs::write(self.folder.join("soak.md"), self.markdown()).expect("the report");
    }

    fn markdown(&self) -> String {
        let mut text = String::from(
            "| fault | n | no motion before | commanded p50, max \\[m\\] | for p50, max \\[s\\] | moved p50, max \\[m\\] | limit \\[s\\] | too long |\n\
             |---|---|---|---|---|---|---|---|\n",
        );
        let mut by_kind: BTreeMap<Kind, Vec<&Round>> = BTreeMap::new();
        for round in &self.rounds {
            by_kind.entry(round.kind).or_default().push(round);
        }
        for (kind, rounds) in by_kind {
            let of = |figure: fn(&Motion) -> f64| {
                let motions = rounds.iter().filter_map(|round| round.motion.as_ref());
                quantiles(motions.map(figure).collect())
            };
            text += &format!(
                "| {} | {} | {} | {} | {} | {} | {:.1} | {} |\n",
                kind.name(),
                rounds.len(),
                rounds.iter().filter(|round| round.motion.is_none()).count(),
                of(|motion| motion.commanded_m),
                quantiles(rounds.iter().filter_map(|round| round.seconds()).collect()),
                of(|motion| motion.moved_m),
                kind.limit().as_secs_f64(),
                rounds.iter().filter(|round| round.is_exceeded()).count(),
            );
        }
        text += "\n| process | rounds | memory first, last, most \\[MiB\\] | growth \\[MiB/h\\] |\n|---|---|---|---|\n";
        for (name, sizes) in &self.memory {
            let Some((first, last)) = sizes.first().zip(sizes.last()) else {
                continue;
            };
            let most = sizes.iter().map(|(_, mib)| *mib).fold(0.0, f64::max);
            text += &format!(
                "| {name} | {} | {:.0}, {:.0}, {most:.0} | {:.1} |\n",
                sizes.len(),
                first.1,
                last.1,
                growth(sizes) * 3_600.0
            );
        }
        text += "\n";
        text += &self.balance.markdown();
        text += "\n| node | counted | messages |\n|---|---|---|\n";
        for (node, totals) in &self.totals {
            for (key, total) in totals.iter().filter(|(key, _)| key.starts_with("dropped")) {
                text += &format!("| {node} | {key} | {total} |\n");
            }
        }
        text
    }
}

/// Median and maximum.
fn quantiles(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    match (values.get(values.len() / 2), values.last()) {
        (Some(median), Some(most)) => format!("{median:.3}, {most:.3}"),
        _ => "-".to_owned(),
    }
}

/// Slope of the second half, after the process has settled, by least squares \[MiB/s\].
fn growth(sizes: &[(f64, f64)]) -> f64 {
    let sizes = sizes.get(sizes.len() / 2..).unwrap_or_default();
    let count = sizes.len().max(1) as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| sizes.iter().map(of).sum::<f64>() / count;
    let (seconds, mib) = (mean(|size| size.0), mean(|size| size.1));
    let (mut both, mut square) = (0.0, 0.0);
    for size in sizes {
        both += (size.0 - seconds) * (size.1 - mib);
        square += (size.0 - seconds) * (size.0 - seconds);
    }
    if square > 0.0 { both / square } else { 0.0 }
}
