//! Correlation of imagined scores with success on the arm, over policies.

use anyhow::Result;
use serde::Serialize;
use wm_metrics::{
    MetricError,
    correlation::{self, pearson, spearman},
    statistics::{Bootstrap, bootstrap},
};

use super::start::{Outcome, Start};

/// Score of a policy: the mean over its episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Score {
    /// Probability of success in imagination.
    Imagined,
    /// Whether that probability is above one half.
    ImaginedRate,
    /// Probability of success by the true pictures.
    Seen,
}

/// Reference of a score: a share of a policy's episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Success {
    /// Share that reached the goal.
    Executed,
    /// Share whose final state follows the instruction, the only input of the probe.
    Followed,
}

/// A score against success, over policies.
#[derive(Clone, Debug, Serialize)]
pub struct Agreement {
    pub score: Score,
    pub success: Success,
    /// `None` if one side is equal for all policies.
    pub pearson: Option<Coefficient>,
    pub spearman: Option<Coefficient>,
}

/// A correlation coefficient.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Coefficient {
    pub value: f64,
    /// 95 % percentile bootstrap over the starts, for these policies.
    pub interval: [f64; 2],
    /// 95 % interval by Fisher's z over the policies, as random draws; `None` below four.
    pub interval_of_policies: Option<[f64; 2]>,
}

impl Score {
    pub const ALL: [Self; 3] = [Self::Imagined, Self::ImaginedRate, Self::Seen];

    fn of(self, outcome: &Outcome) -> f64 {
        match self {
            Self::Imagined => f64::from(outcome.imagined),
            Self::ImaginedRate => f64::from(u8::from(outcome.imagined > 0.5)),
            Self::Seen => f64::from(outcome.seen),
        }
    }
}

impl Success {
    pub const ALL: [Self; 2] = [Self::Executed, Self::Followed];

    fn of(self, outcome: &Outcome) -> f64 {
        let succeeded = match self {
            Self::Executed => outcome.executed,
            Self::Followed => outcome.followed,
        };
        f64::from(u8::from(succeeded))
    }
}

impl Agreement {
    /// Every score with every success; all starts have the same policies.
    pub fn all(starts: &[Start]) -> Result<Vec<Self>> {
        let pairs = Success::ALL
            .into_iter()
            .flat_map(|success| Score::ALL.map(|score| (score, success)));
        let agreements = pairs.map(|(score, success)| {
            let sides = Sides {
                starts,
                score,
                success,
            };
            Ok(Self {
                score,
                success,
                pearson: sides.coefficient(pearson)?,
                spearman: sides.coefficient(spearman)?,
            })
        });
        agreements.collect()
    }
}

struct Sides<'a> {
    starts: &'a [Start],
    score: Score,
    success: Success,
}

type Correlate = fn(&[f64], &[f64]) -> Result<correlation::Correlation, MetricError>;

impl Sides<'_> {
    fn coefficient(&self, correlate: Correlate) -> Result<Option<Coefficient>> {
        let of = |drawn: &[usize]| {
            let mean = |value: &dyn Fn(&Outcome) -> f64| self.means(drawn, value);
            let (score, success) = (self.score, self.success);
            match correlate(
                &mean(&|outcome| score.of(outcome)),
                &mean(&|outcome| success.of(outcome)),
            ) {
                Err(MetricError::Constant { .. } | MetricError::TooFew { .. }) => Ok(None),
                found => found.map(Some),
            }
        };
        let every: Vec<usize> = (0..self.starts.len()).collect();
        let Some(found) = of(&every)? else {
            return Ok(None);
        };
        // Starts without differences between policies show no correlation.
        let estimate = bootstrap(self.starts.len(), &Bootstrap::default(), |drawn| {
            of(drawn).ok().flatten().map_or(0.0, |found| found.r)
        })?;
        Ok(Some(Coefficient {
            value: found.r,
            interval: [estimate.interval.low, estimate.interval.high],
            interval_of_policies: found.interval.map(|own| [own.low, own.high]),
        }))
    }

    /// Mean of each policy over the drawn starts.
    fn means(&self, drawn: &[usize], value: &dyn Fn(&Outcome) -> f64) -> Vec<f64> {
        let mut sums: Vec<f64> = Vec::new();
        for start in drawn.iter().filter_map(|index| self.starts.get(*index)) {
            sums.resize(start.outcomes.len(), 0.0);
            for (sum, outcome) in sums.iter_mut().zip(&start.outcomes) {
                *sum += value(outcome);
            }
        }
        sums.iter().map(|sum| sum / drawn.len() as f64).collect()
    }
}
