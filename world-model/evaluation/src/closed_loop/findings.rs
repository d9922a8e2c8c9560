//! What closed loops found, as JSON and as text.

use std::fmt;

use anyhow::{Context as _, Result};
use serde::Serialize;
use wm_metrics::statistics::wilson;

use super::{settings::ClosedLoopSettings, trial::Trial};

/// What came of all episodes of a planner.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    #[serde(flatten)]
    pub about: About,
    pub success_rate: f64,
    /// Wilson's, 95 %.
    pub interval: [f64; 2],
    /// `None` where nothing was planned.
    pub plan_ms: Option<Percentiles>,
    /// Mean number of candidates of a plan.
    pub candidates: f64,
    /// Plans that took longer than a model step.
    pub deadline_misses: usize,
    pub episodes: Vec<Episode>,
}

/// Time of a plan \[ms\].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Percentiles {
    pub p50: f64,
    pub p95: f64,
}

/// One of the episodes.
#[derive(Clone, Debug, Serialize)]
pub struct Episode {
    pub seed: u64,
    pub success: bool,
    /// Model steps.
    pub steps: usize,
    /// What was missing in the end.
    pub distance_m: f64,
}

/// What was run.
#[derive(Clone, Debug, Serialize)]
pub struct About {
    pub task: String,
    pub planner: String,
    /// Whether the simulator was the planner's model.
    pub perfect_model: bool,
    pub model: String,
    pub model_hash: String,
    pub seed: u64,
    pub settings: ClosedLoopSettings,
    /// Time of a model step \[ms\].
    pub step_ms: f64,
}

impl Findings {
    pub fn of(about: About, trials: &[Trial]) -> Result<Self> {
        let successes = trials.iter().filter(|trial| trial.success).count();
        let interval = wilson(successes, trials.len())?;
        let plans = || trials.iter().flat_map(|trial| &trial.plans);
        let mut times: Vec<f64> = plans().map(|plan| plan.ms).collect();
        times.sort_by(f64::total_cmp);
        // Counts stay far below 2^52.
        let at = |share: f64| {
            let index = (share * (times.len() as f64 - 1.0)).round() as usize;
            times.get(index).copied()
        };
        let plan_ms = at(0.5)
            .zip(at(0.95))
            .map(|(p50, p95)| Percentiles { p50, p95 });
        let candidates: usize = plans().map(|plan| plan.candidates).sum();
        Ok(Self {
            success_rate: successes as f64 / trials.len() as f64,
            interval: [interval.low, interval.high],
            plan_ms,
            candidates: candidates as f64 / times.len().max(1) as f64,
            deadline_misses: times.iter().filter(|ms| **ms > about.step_ms).count(),
            episodes: trials
                .iter()
                .map(|trial| Episode {
                    seed: trial.seed,
                    success: trial.success,
                    steps: trial.steps,
                    distance_m: trial.distance_m,
                })
                .collect(),
            about,
        })
    }

    pub fn to_json(&self) -> Result<String> {
        let mut text = serde_json::to_string_pretty(self).context("the findings as JSON")?;
        text.push('\n');
        Ok(text)
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let with = if self.about.perfect_model {
            ", with the simulator as its model"
        } else {
            ""
        };
        let [low, high] = self.interval;
        write!(
            f,
            "{} by {}{with}: {:.0} % of {} episodes [{:.0}, {:.0}]",
            self.about.task,
            self.about.planner,
            self.success_rate * 100.0,
            self.episodes.len(),
            low * 100.0,
            high * 100.0
        )?;
        if let Some(Percentiles { p50, p95 }) = self.plan_ms {
            write!(
                f,
                "; a plan of {:.0} candidates takes {p50:.0} ms (p95 {p95:.0}), longer than a model step: {}",
                self.candidates, self.deadline_misses
            )?;
        }
        Ok(())
    }
}
