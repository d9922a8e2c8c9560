//! The findings, as JSON and text.

use std::fmt;

use anyhow::{Context as _, Result};
use serde::Serialize;
use wm_metrics::statistics::{Bootstrap, bootstrap_mean, wilson};

use super::{
    candidate::Candidate,
    correlation::{Agreement, Coefficient, Score, Success},
    start::{Outcome, Start},
};

/// Results of all policies.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    #[serde(flatten)]
    pub about: RunInfo,
    pub agreements: Vec<Agreement>,
    pub policies: Vec<Policy>,
}

/// Description of the run.
#[derive(Clone, Debug, Serialize)]
pub struct RunInfo {
    pub task: String,
    pub model: String,
    pub model_hash: String,
    pub seed: u64,
    /// Starts per policy.
    pub starts: usize,
    /// Length of an episode, as a multiple of the oracle's.
    pub patience: f64,
}

/// Results of a policy.
#[derive(Clone, Debug, Serialize)]
pub struct Policy {
    pub policy: String,
    /// Share of episodes that reached the goal.
    pub executed: Share,
    /// Share of episodes whose final state follows the instruction.
    pub followed: Share,
    /// By the true pictures.
    pub seen: ProbeResult,
    /// By the predictions of the world model.
    pub imagined: ProbeResult,
    pub episodes: Vec<Episode>,
}

/// A share of episodes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Share {
    pub rate: f64,
    /// Wilson's, 95 %.
    pub interval: [f64; 2],
}

/// Success according to the probe.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ProbeResult {
    /// Mean probability of success.
    pub probability: f64,
    /// 95 % percentile bootstrap of the starts.
    pub interval: [f64; 2],
    /// Episodes with a probability above one half.
    pub successes: Share,
}

/// One episode.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Episode {
    pub seed: u64,
    /// Model steps.
    pub steps: usize,
    pub executed: bool,
    pub followed: bool,
    /// Remaining distance to the goal \[m\].
    pub distance_m: f64,
    /// Probability by the true pictures.
    pub seen: f32,
    /// Probability in imagination.
    pub imagined: f32,
}

impl Findings {
    /// Findings of the policies from all starts.
    pub fn of(about: RunInfo, candidates: &[Candidate], starts: &[Start]) -> Result<Self> {
        let found = candidates.iter().enumerate();
        let found = found.map(|(index, candidate)| Policy::of(candidate, index, starts));
        Ok(Self {
            about,
            agreements: Agreement::all(starts)?,
            policies: found.collect::<Result<_>>()?,
        })
    }

    pub fn to_json(&self) -> Result<String> {
        let mut text = serde_json::to_string_pretty(self).context("the findings as JSON")?;
        text.push('\n');
        Ok(text)
    }
}

impl Policy {
    fn of(candidate: &Candidate, index: usize, starts: &[Start]) -> Result<Self> {
        let found = starts.iter().filter_map(|start| {
            let outcome = start.outcomes.get(index)?;
            Some((start, *outcome))
        });
        let found: Vec<(&Start, Outcome)> = found.collect();
        let share = |succeeded: &dyn Fn(&Outcome) -> bool| -> Result<Share> {
            let successes = found.iter().filter(|(_, own)| succeeded(own)).count();
            let interval = wilson(successes, found.len())?;
            Ok(Share {
                rate: successes as f64 / found.len() as f64,
                interval: [interval.low, interval.high],
            })
        };
        let judged = |probability: fn(&Outcome) -> f32| -> Result<ProbeResult> {
            let values = found.iter().map(|(_, own)| f64::from(probability(own)));
            let values: Vec<f64> = values.collect();
            let mean = bootstrap_mean(&values, &Bootstrap::default())?;
            Ok(ProbeResult {
                probability: mean.value,
                interval: [mean.interval.low, mean.interval.high],
                successes: share(&|own| probability(own) > 0.5)?,
            })
        };
        Ok(Self {
            policy: candidate.to_string(),
            executed: share(&|own| own.executed)?,
            followed: share(&|own| own.followed)?,
            seen: judged(|own| own.seen)?,
            imagined: judged(|own| own.imagined)?,
            episodes: found
                .iter()
                .map(|(start, own)| Episode {
                    seed: start.seed,
                    steps: start.steps,
                    executed: own.executed,
                    followed: own.followed,
                    distance_m: own.distance_m,
                    seen: own.seen,
                    imagined: own.imagined,
                })
                .collect(),
        })
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let RunInfo { task, starts, .. } = &self.about;
        let count = self.policies.len();
        writeln!(
            f,
            "{task}: {count} policies from {starts} starts; success [%] with 95 % intervals"
        )?;
        writeln!(
            f,
            "{:<16}{:<18}{:<18}{:<18}imagined",
            "policy", "on the arm", "as words ask", "by the pictures"
        )?;
        for own in &self.policies {
            writeln!(
                f,
                "{:<16}{:<18}{:<18}{:<18}{}",
                own.policy,
                percent(own.executed.rate, own.executed.interval),
                percent(own.followed.rate, own.followed.interval),
                percent(own.seen.probability, own.seen.interval),
                percent(own.imagined.probability, own.imagined.interval)
            )?;
        }
        for agreement in &self.agreements {
            writeln!(f, "{agreement}")?;
        }
        Ok(())
    }
}

fn percent(value: f64, [low, high]: [f64; 2]) -> String {
    let [value, low, high] = [value, low, high].map(|own| own * 100.0);
    format!("{value:.0} [{low:.0}, {high:.0}]")
}

impl fmt::Display for Agreement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let score = match self.score {
            Score::Imagined => "imagined",
            Score::ImaginedRate => "imagined, above one half",
            Score::Seen => "by the pictures",
        };
        let success = match self.success {
            Success::Executed => "on the arm",
            Success::Followed => "as words ask",
        };
        let write = |coefficient: &Option<Coefficient>| match coefficient {
            None => "none: all policies are the same".to_owned(),
            Some(own) => {
                let [low, high] = own.interval;
                let of_policies = own.interval_of_policies;
                let of_policies = of_policies.map_or(String::new(), |[low, high]| {
                    format!(", over policies [{low:.2}, {high:.2}]")
                });
                format!("{:.2} [{low:.2}, {high:.2}]{of_policies}", own.value)
            }
        };
        write!(
            f,
            "{score} and {success}: Pearson {}; Spearman {}",
            write(&self.pearson),
            write(&self.spearman)
        )
    }
}
