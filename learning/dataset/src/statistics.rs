use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use wm_motion::actions::{ActionError, ActionSpace, Spread};

use super::Episode;

/// Statistics of values, one number per dimension, with the names of LeRobot.
///
/// Quantiles are interpolated linearly, NumPy's default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Statistics {
    /// Least value.
    pub min: Vec<f64>,
    /// Greatest value.
    pub max: Vec<f64>,
    /// Mean.
    pub mean: Vec<f64>,
    /// Population standard deviation (divided by n).
    pub std: Vec<f64>,
    /// Quantile 0.01.
    pub q01: Vec<f64>,
    /// Quantile 0.10.
    pub q10: Vec<f64>,
    /// Median.
    pub q50: Vec<f64>,
    /// Quantile 0.90.
    pub q90: Vec<f64>,
    /// Quantile 0.99.
    pub q99: Vec<f64>,
    /// Number of frames, as a list of one.
    pub count: Vec<u64>,
}

impl Statistics {
    /// Statistics of rows of `width` values.
    #[must_use]
    pub fn of_rows<'a>(rows: impl Iterator<Item = &'a [f32]> + Clone, width: usize) -> Self {
        let mut statistics = Self::default();
        let mut count = 0;
        for index in 0..width {
            let column = rows.clone().filter_map(|row| row.get(index));
            let mut sorted: Vec<f64> = column.map(|value| f64::from(*value)).collect();
            sorted.sort_unstable_by(f64::total_cmp);
            count = sorted.len();
            statistics.push(&sorted);
        }
        statistics.count.push(count as u64);
        statistics
    }

    fn push(&mut self, sorted: &[f64]) {
        let (Some(min), Some(max)) = (sorted.first(), sorted.last()) else {
            return;
        };
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let variance = sorted.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        self.min.push(*min);
        self.max.push(*max);
        self.mean.push(mean);
        self.std.push(variance.sqrt());
        for (quantiles, share) in [
            (&mut self.q01, 0.01),
            (&mut self.q10, 0.10),
            (&mut self.q50, 0.50),
            (&mut self.q90, 0.90),
            (&mut self.q99, 0.99),
        ] {
            let place = share * (n - 1.0);
            // Not negative, and below n; the index n is the greatest value.
            let low = sorted.get(place.floor() as usize).copied().unwrap_or(*max);
            let high = sorted.get(place.ceil() as usize).copied().unwrap_or(*max);
            quantiles.push(low + (high - low) * place.fract());
        }
    }
}

/// Statistics of a prepared folder: `statistics.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DataStatistics {
    /// Names of the action's values.
    pub names: Vec<String>,
    /// Actions of the training episodes, each over one period.
    pub action: Statistics,
    /// Latents of the training episodes, if encoded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latent: Option<LatentStatistics>,
    /// The action space with scales, offsets and clips fitted to the actions.
    pub action_space: ActionSpace,
    /// Number of episodes with each instruction.
    pub instructions: BTreeMap<String, usize>,
    /// Numbers of successful, failed and unknown episodes.
    pub success: SuccessCounts,
}

/// Successes of episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessCounts {
    /// Successful episodes.
    pub succeeded: usize,
    /// Failed episodes.
    pub failed: usize,
    /// Episodes of unknown success.
    pub unknown: usize,
}

/// Statistics of latents, one number per channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LatentStatistics {
    /// Name and hash of the latent space.
    pub space: String,
    /// Mean.
    pub mean: Vec<f64>,
    /// Population standard deviation.
    pub std: Vec<f64>,
    /// Number of frames.
    pub count: u64,
}

impl DataStatistics {
    /// Statistics of training episodes.
    ///
    /// # Errors
    /// Those of [`ActionSpace::fitted`].
    pub fn of_episodes<'a>(
        episodes: impl Iterator<Item = &'a Episode> + Clone,
        space: &ActionSpace,
    ) -> Result<Self, ActionError> {
        let rows = episodes.clone().flat_map(|episode| &episode.actions);
        let action = Statistics::of_rows(rows.clone().map(Vec::as_slice), space.len());
        let spread = |index| Spread::of(rows.clone().filter_map(|row| row.get(index).copied()));
        let spreads: Vec<Spread> = (0..space.len()).filter_map(spread).collect();
        let mut statistics = Self {
            names: space.dimensions().iter().map(|d| d.name.clone()).collect(),
            action_space: space.fitted(&spreads)?,
            action,
            latent: None,
            instructions: BTreeMap::new(),
            success: SuccessCounts::default(),
        };
        for episode in episodes {
            if let Some(instruction) = &episode.instruction {
                *statistics
                    .instructions
                    .entry(instruction.clone())
                    .or_default() += 1;
            }
            let success = &mut statistics.success;
            *match episode.success {
                Some(true) => &mut success.succeeded,
                Some(false) => &mut success.failed,
                None => &mut success.unknown,
            } += 1;
        }
        Ok(statistics)
    }
}
