//! The cross-entropy method over action sequences.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::{
    PlanError, PlannedActions, Planner, Problem, Watch,
    error::{check_elites, check_positive},
    proposal::Proposal,
    search::Search,
};

/// The plan that a search returns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Returned {
    /// The candidate of least cost, as in the reference.
    #[default]
    BestSeen,
    /// The mean of the last iteration's elites, rolled out once more for its cost.
    FinalMean,
}

/// Settings of the cross-entropy method. The defaults of population, iterations and elites are those of the
/// controllability metric; real-time planning on a CPU needs fewer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CemSettings {
    /// Candidates per iteration.
    pub population: usize,
    /// Iterations.
    pub iterations: usize,
    /// Candidates that fit the next Gaussian.
    pub elites: usize,
    /// Standard deviation of the first iteration, as a share of each value's range.
    pub initial_std: f32,
    /// Least standard deviation \[model units\].
    pub std_floor: f32,
    /// Whether proposals are candidates too; the metric uses the first one only as the first mean.
    pub try_proposals: bool,
    /// Which plan is returned.
    pub returned: Returned,
}

impl Default for CemSettings {
    fn default() -> Self {
        Self {
            population: 400,
            iterations: 5,
            elites: 50,
            initial_std: 0.25,
            std_floor: 1e-4,
            try_proposals: false,
            returned: Returned::BestSeen,
        }
    }
}

/// The cross-entropy method (architecture.md, *Planner*; the paper, appendix B).
///
/// Each iteration draws a population from a diagonal Gaussian, applies the limits, rolls it out, and fits the next
/// Gaussian to the elites (unbiased standard deviation, no less than the floor). Candidates without a finite cost are
/// never elites and never returned. The first mean is the first proposal, or no motion.
#[derive(Clone, Debug)]
pub struct Cem {
    settings: CemSettings,
}

impl Cem {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid setting.
    pub fn new(settings: CemSettings) -> Result<Self, PlanError> {
        check_positive("population", settings.population as f32)?;
        check_positive("iterations", settings.iterations as f32)?;
        check_elites(settings.elites, settings.population)?;
        check_positive("initial_std", settings.initial_std)?;
        check_positive("std_floor", settings.std_floor)?;
        Ok(Self { settings })
    }

    /// The settings.
    pub fn settings(&self) -> &CemSettings {
        &self.settings
    }
}

impl Planner for Cem {
    fn name(&self) -> &'static str {
        "cem"
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let CemSettings {
            population,
            iterations,
            elites,
            initial_std,
            std_floor,
            try_proposals,
            returned,
        } = self.settings;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut search = Search::new(problem, watch)?;
        let space = search.problem.space;
        let mut proposal = Proposal::about(space, &search.start(), initial_std, std_floor);
        let mut known = if try_proposals {
            search.proposals()
        } else {
            Vec::new()
        };
        for _ in 0..iterations {
            // All are drawn first, so that the batch size does not change the plan.
            let mut candidates = std::mem::take(&mut known);
            let drawn = population.saturating_sub(candidates.len());
            candidates
                .extend((0..drawn).map(|_| proposal.draw(|| StandardNormal.sample(&mut rng))));
            let Some(mut scored) = search.iterate(candidates)? else {
                break;
            };
            scored.truncate(elites);
            proposal.fit(&scored, 0.0);
        }
        let mean = match returned {
            Returned::BestSeen => None,
            Returned::FinalMean => search.try_one(proposal.middle())?,
        };
        search.finish(mean)
    }
}

#[cfg(test)]
mod tests;
