//! Settings of the cross-entropy method.

use serde::{Deserialize, Serialize};

use super::PlanError;

/// Which actions a search returns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Returned {
    /// The candidate of least cost among all that were tried: the reference's choice.
    #[default]
    BestSeen,
    /// The mean of the last iteration's elites, rolled out once more for its cost.
    FinalMean,
}

/// Settings of the cross-entropy method. The defaults of population, iterations and elites are those of the
/// controllability metric; planning on a processor in real time wants fewer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CemSettings {
    /// Candidates an iteration.
    pub population: usize,
    /// Iterations.
    pub iterations: usize,
    /// Candidates that the next Gaussian is fitted to.
    pub elites: usize,
    /// Model steps k of a plan.
    pub horizon: usize,
    /// Most candidates rolled out at once: bounds memory, and is how often the deadline is looked at.
    pub batch: usize,
    /// Standard deviation of the first iteration, as a part of each value's range.
    pub initial_std: f32,
    /// Least standard deviation \[model units\].
    pub std_floor: f32,
    /// Which actions are returned.
    pub returned: Returned,
}

impl Default for CemSettings {
    fn default() -> Self {
        Self {
            population: 400,
            iterations: 5,
            elites: 50,
            horizon: 1,
            batch: 64,
            initial_std: 0.25,
            std_floor: 1e-4,
            returned: Returned::BestSeen,
        }
    }
}

impl CemSettings {
    /// Whether the numbers can serve.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first one that cannot.
    pub fn validate(&self) -> Result<(), PlanError> {
        let complain = |text: String| Err(PlanError::Setting(text));
        for (name, value) in [
            ("population", self.population),
            ("iterations", self.iterations),
            ("horizon", self.horizon),
            ("batch", self.batch),
        ] {
            if value == 0 {
                return complain(format!("{name} must be at least 1"));
            }
        }
        // Two elites are the fewest that have an unbiased standard deviation.
        if self.elites < 2 || self.elites > self.population {
            return complain(format!(
                "elites must be at least 2 and at most the population of {}, not {}",
                self.population, self.elites
            ));
        }
        for (name, value) in [
            ("initial_std", self.initial_std),
            ("std_floor", self.std_floor),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return complain(format!("{name} must be positive and finite, not {value}"));
            }
        }
        Ok(())
    }
}
