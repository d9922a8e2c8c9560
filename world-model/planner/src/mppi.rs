//! Model predictive path integral control: Williams et al., *Information Theoretic MPC for Model-Based Reinforcement
//! Learning*, ICRA 2017.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::{
    PlanError, PlannedActions, Planner, Problem, Watch,
    error::check_positive,
    proposal::Proposal,
    search::{ScoredCandidate, Search},
};

/// Settings of MPPI. The defaults are for real-time planning on a CPU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MppiSettings {
    /// Candidates an iteration.
    pub population: usize,
    /// Iterations.
    pub iterations: usize,
    /// Standard deviation of the noise in all iterations, as a share of each value's range.
    pub std: f32,
    /// Temperature lambda, as a share of the standard deviation of an iteration's costs. A lower one gives the best
    /// candidates more weight.
    pub temperature: f32,
}

impl Default for MppiSettings {
    fn default() -> Self {
        Self {
            population: 24,
            iterations: 3,
            std: 0.15,
            temperature: 0.3,
        }
    }
}

/// MPPI: the plan is the mean of all candidates, weighted by exp(-cost / lambda). Proposals are candidates of the first
/// iteration, whose mean is the first proposal. The final mean is rolled out; the cheaper of it and the best candidate
/// is returned.
#[derive(Clone, Debug)]
pub struct Mppi {
    settings: MppiSettings,
}

impl Mppi {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid setting.
    pub fn new(settings: MppiSettings) -> Result<Self, PlanError> {
        check_positive("population", settings.population as f32)?;
        check_positive("iterations", settings.iterations as f32)?;
        check_positive("std", settings.std)?;
        check_positive("temperature", settings.temperature)?;
        Ok(Self { settings })
    }
}

impl Planner for Mppi {
    fn name(&self) -> &'static str {
        "mppi"
    }

    fn plan(
        &self,
        problem: &mut Problem<'_>,
        seed: u64,
        watch: Watch<'_>,
    ) -> Result<PlannedActions, PlanError> {
        let settings = &self.settings;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut search = Search::new(problem, watch)?;
        let mut known = search.proposals();
        let space = search.problem.space;
        let mut mean = search.start();
        for _ in 0..settings.iterations {
            let mut proposal = Proposal::about(space, &mean, settings.std, f32::MIN_POSITIVE);
            let mut candidates = std::mem::take(&mut known);
            while candidates.len() < settings.population {
                candidates.push(proposal.draw(|| StandardNormal.sample(&mut rng)));
            }
            let Some(scored) = search.iterate(candidates)? else {
                break;
            };
            let weights = weights(&scored, settings.temperature);
            proposal.fit_weighted(&scored, &weights, 0.0);
            mean = proposal.middle();
        }
        let mean = search.try_one(mean)?;
        let best = search.best_cost();
        let is_best = |mean: &ScoredCandidate| best.is_none_or(|best| mean.cost <= best);
        search.finish(mean.filter(is_best))
    }
}

/// Weights exp(-cost / lambda), normalised to sum 1.
fn weights(scored: &[ScoredCandidate], temperature: f32) -> Vec<f64> {
    let least = scored.first().map_or(0.0, |best| f64::from(best.cost));
    // Counts stay far below 2^52.
    let count = scored.len() as f64;
    let above = || scored.iter().map(|scored| f64::from(scored.cost) - least);
    let mean = above().sum::<f64>() / count;
    let variance = above().map(|cost| (cost - mean).powi(2)).sum::<f64>() / count;
    // Equal costs have equal weights.
    let lambda = (variance.sqrt() * f64::from(temperature)).max(f64::MIN_POSITIVE);
    let raw: Vec<f64> = above().map(|cost| (-cost / lambda).exp()).collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|weight| weight / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Point, bounds, objective, problem};

    #[test]
    fn reaches_a_goal_deterministically() {
        let (space, objective) = (bounds(), objective(&[1.2, -0.6]));
        let settings = MppiSettings {
            iterations: 8,
            ..MppiSettings::default()
        };
        let mppi = Mppi::new(settings).unwrap();
        let plan = || {
            let mut point = Point::new(2);
            mppi.plan(&mut problem(&space, &mut point, &objective), 1, &mut |_| {
                false
            })
            .unwrap()
        };
        let found = plan();
        assert!(found.cost < 0.02, "{found:?}");
        assert_eq!(found, plan());
    }

    #[test]
    fn cheapest_candidate_weighs_most() {
        let scored = |costs: &[f32]| {
            let scored = costs
                .iter()
                .map(|cost| ScoredCandidate::of(*cost, vec![0.0]));
            scored.collect::<Vec<_>>()
        };
        assert_eq!(weights(&scored(&[2.0, 2.0]), 0.3), [0.5, 0.5]);
        let unequal = weights(&scored(&[1.0, 2.0, 3.0]), 0.3);
        assert!(unequal[0] > 0.9 && unequal[1] > unequal[2]);
        assert!((unequal.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}
