//! The improved cross-entropy method: Pinneri et al., *Sample-efficient Cross-Entropy Method for Real-time Planning*,
//! CoRL 2020.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use crate::{
    PlanError, PlannedActions, Planner, Problem, Watch,
    error::{check_elites, check_positive, check_share},
    proposal::Proposal,
    search::{ScoredCandidate, Search},
};

/// Settings of iCEM. The defaults are for real-time planning on a CPU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct IcemSettings {
    /// Candidates of the first iteration.
    pub population: usize,
    /// Iterations.
    pub iterations: usize,
    /// Candidates that fit the next Gaussian.
    pub elites: usize,
    /// Standard deviation of the first iteration, as a share of each value's range.
    pub initial_std: f32,
    /// Least standard deviation \[model units\].
    pub std_floor: f32,
    /// Exponent beta of the noise's power spectrum f^-beta over time: 0 is white; greater is smoother.
    pub noise_beta: f32,
    /// Factor by which the population shrinks per iteration, never below twice the elites.
    pub decay: f32,
    /// Share of the elites that are candidates of the next iteration.
    pub kept_elites: f32,
    /// Share of the last Gaussian in the new one.
    pub momentum: f32,
}

impl Default for IcemSettings {
    fn default() -> Self {
        Self {
            population: 24,
            iterations: 3,
            elites: 6,
            initial_std: 0.25,
            std_floor: 0.02,
            noise_beta: 2.0,
            decay: 1.25,
            kept_elites: 0.3,
            momentum: 0.1,
        }
    }
}

/// iCEM: noise correlated over time, elites kept between iterations, a shrinking population, and the mean as a
/// candidate of the last iteration. Proposals are candidates of the first iteration. Returns the best candidate seen.
#[derive(Clone, Debug)]
pub struct Icem {
    settings: IcemSettings,
}

impl Icem {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names the first invalid setting.
    pub fn new(settings: IcemSettings) -> Result<Self, PlanError> {
        check_positive("population", settings.population as f32)?;
        check_positive("iterations", settings.iterations as f32)?;
        check_elites(settings.elites, settings.population)?;
        check_positive("initial_std", settings.initial_std)?;
        check_positive("std_floor", settings.std_floor)?;
        check_share("kept_elites", settings.kept_elites)?;
        check_share("momentum", settings.momentum)?;
        if !(1.0..=10.0).contains(&settings.decay) || !(0.0..=10.0).contains(&settings.noise_beta) {
            return Err(PlanError::Setting(format!(
                "decay must be from 1 to 10 and noise_beta from 0 to 10, not {} and {}",
                settings.decay, settings.noise_beta
            )));
        }
        Ok(Self { settings })
    }
}

impl Planner for Icem {
    fn name(&self) -> &'static str {
        "icem"
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
        let (space, steps) = (search.problem.space, search.problem.horizon);
        let mut proposal = Proposal::about(
            space,
            &search.start(),
            settings.initial_std,
            settings.std_floor,
        );
        let coloured = ColouredNoise::new(steps, settings.noise_beta);
        let mut population = settings.population as f32;
        for iteration in 1..=settings.iterations {
            let mut candidates = std::mem::take(&mut known);
            if iteration == settings.iterations {
                candidates.push(proposal.middle());
            }
            let size = (population.round() as usize).max(2 * settings.elites);
            while candidates.len() < size {
                // Noise over the steps for each value, read step by step.
                let noise: Vec<Vec<f32>> = (0..space.len())
                    .map(|_| coloured.draw(&mut || StandardNormal.sample(&mut rng)))
                    .collect();
                let mut values = (0..steps)
                    .flat_map(|step| noise.iter().filter_map(move |noise| noise.get(step)));
                // `draw` takes one number per value: `values` never ends early.
                let next = || values.next().copied().unwrap_or_default();
                candidates.push(proposal.draw(next));
            }
            let Some(mut scored) = search.iterate(candidates)? else {
                break;
            };
            scored.truncate(settings.elites);
            proposal.fit(&scored, settings.momentum);
            // At most the number of elites.
            let kept = (settings.kept_elites * settings.elites as f32).ceil() as usize;
            let keep = |elite: &ScoredCandidate| elite.actions.clone();
            known = scored.iter().take(kept).map(keep).collect();
            population /= settings.decay;
        }
        let found = search.finish(None)?;
        let elites = known.iter().map(|elite| {
            let actions = elite.chunks_exact(space.len());
            actions.map(<[f32]>::to_vec).collect()
        });
        let others = elites.filter(|elite| *elite != found.actions);
        Ok(PlannedActions {
            elites: others.collect(),
            ..found
        })
    }
}

/// Noise over the steps of a plan with a power-law spectrum, of variance 1.
struct ColouredNoise {
    /// Amplitude of the frequencies 0, 1, .. half the steps.
    amplitudes: Vec<f32>,
    steps: usize,
}

impl ColouredNoise {
    fn new(steps: usize, beta: f32) -> Self {
        // The lowest frequency counts for the constant one too (Timmer and Koenig, 1995).
        let raw = (0..=steps / 2).map(|f| (f.max(1) as f32).powf(-beta / 2.0));
        let raw: Vec<f32> = raw.collect();
        // Cosine and sine of one amplitude have its square as variance at every step.
        let power: f32 = raw.iter().map(|amplitude| amplitude * amplitude).sum();
        let amplitudes = raw.iter().map(|amplitude| amplitude / power.sqrt());
        Self {
            amplitudes: amplitudes.collect(),
            steps,
        }
    }

    /// Draws one number per step.
    fn draw(&self, normal: &mut dyn FnMut() -> f32) -> Vec<f32> {
        let waves: Vec<(f32, f32)> = self
            .amplitudes
            .iter()
            .map(|amplitude| (amplitude * normal(), amplitude * normal()))
            .collect();
        let at = |step: usize| {
            let of = |(f, (cosine, sine)): (usize, &(f32, f32))| {
                // Few steps and frequencies: exact in f32.
                let angle = std::f32::consts::TAU * (f * step) as f32 / self.steps as f32;
                cosine * angle.cos() + sine * angle.sin()
            };
            waves.iter().enumerate().map(of).sum()
        };
        (0..self.steps).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Point, bounds, objective, problem};

    fn plan(settings: IcemSettings, goal: &[f32], seed: u64) -> PlannedActions {
        let (space, objective) = (bounds(), objective(goal));
        let mut point = Point::new(2);
        let icem = Icem::new(settings).unwrap();
        icem.plan(
            &mut problem(&space, &mut point, &objective),
            seed,
            &mut |_| false,
        )
        .unwrap()
    }

    #[test]
    fn reaches_a_goal_with_a_tenth_of_cems_candidates() {
        let found = plan(
            IcemSettings {
                iterations: 6,
                ..IcemSettings::default()
            },
            &[1.8, -0.9],
            1,
        );
        assert!(found.cost < 0.02 && found.candidates < 160, "{found:?}");
        assert_eq!(
            found,
            plan(
                IcemSettings {
                    iterations: 6,
                    ..IcemSettings::default()
                },
                &[1.8, -0.9],
                1
            )
        );
    }

    #[test]
    fn good_proposal_is_kept() {
        let (space, objective) = (bounds(), objective(&[0.6, 0.3]));
        let mut point = Point::new(2);
        let mut problem = problem(&space, &mut point, &objective);
        problem.proposals = vec![vec![vec![0.0; 2]; 3], vec![vec![0.2, 0.1]; 3]];
        let settings = IcemSettings {
            iterations: 1,
            ..IcemSettings::default()
        };
        let found = Icem::new(settings)
            .unwrap()
            .plan(&mut problem, 3, &mut |_| false)
            .unwrap();
        assert!(found.cost < 1e-10, "{found:?}");
    }

    #[test]
    fn elites_are_kept_and_shifted_with_the_plan() {
        let found = plan(IcemSettings::default(), &[0.6, 0.3], 2);
        // Three tenths of six elites, the best of which is the plan itself.
        assert!(!found.elites.is_empty() && found.elites.len() <= 2);
        assert!(found.elites.iter().all(|elite| *elite != found.actions));
        let next = found.without(1).unwrap();
        for (before, after) in found.proposals().iter().zip(next.proposals()) {
            assert_eq!(after, [&before[1..], &before[2..]].concat());
        }
        assert_eq!(next.proposals().len(), found.elites.len() + 1);
    }

    #[test]
    fn noise_has_unit_variance_and_smoothness_grows_with_beta() {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut correlation = |beta: f32| {
            let noise = ColouredNoise::new(8, beta);
            let (mut squares, mut products) = (0.0, 0.0);
            for _ in 0..4000 {
                let drawn = noise.draw(&mut || StandardNormal.sample(&mut rng));
                squares += drawn.iter().map(|v| v * v).sum::<f32>() / 8.0;
                products += drawn.windows(2).map(|p| p[0] * p[1]).sum::<f32>() / 7.0;
            }
            assert!((squares / 4000.0 - 1.0).abs() < 0.05, "{squares}");
            products / squares
        };
        let (white, smooth) = (correlation(0.0), correlation(2.0));
        assert!(smooth > 0.5 && white < 0.3, "{white} {smooth}");
    }

    #[test]
    fn invalid_settings_are_named() {
        let refused = |settings| Icem::new(settings).unwrap_err().to_string();
        let decay = IcemSettings {
            decay: 0.5,
            ..IcemSettings::default()
        };
        assert!(refused(decay).contains("decay"));
        let kept_elites = IcemSettings {
            kept_elites: 1.0,
            ..IcemSettings::default()
        };
        assert!(refused(kept_elites).contains("kept_elites"));
    }
}
