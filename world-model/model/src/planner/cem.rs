//! The cross-entropy method over action sequences.

use candle_core::{Device, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{CemSettings, Dynamics, PlanError, Returned, Target};

/// What a search found.
#[derive(Clone, Debug, PartialEq)]
pub struct PlannedActions {
    /// One action a model step, in model units, within the bounds: (k, searched values).
    pub actions: Vec<Vec<f32>>,
    /// Cost of [`Self::actions`]: mean squared latent error, normalised units squared.
    pub cost: f32,
    /// Least cost among the candidates of each iteration.
    pub iteration_costs: Vec<f32>,
    /// How many candidates were rolled out.
    pub candidates: usize,
    /// How many of those had no finite cost and were left out.
    pub rejected: usize,
    /// Whether the deadline ended the search before its last iteration was complete.
    pub deadline_cut: bool,
}

impl PlannedActions {
    /// What is left of the plan when its first `passed` steps are over, going on with the last one: the mean to start
    /// the next search from. None where nothing is left.
    pub fn without(&self, passed: usize) -> Option<Self> {
        let left = self.actions.get(passed..)?;
        let last = left.last()?;
        let going_on = std::iter::repeat_n(last, passed);
        let actions = left.iter().chain(going_on).cloned().collect();
        Some(Self {
            actions,
            ..self.clone()
        })
    }
}

/// The cross-entropy method: settings and bounds, both validated.
///
/// Each iteration draws a population from a diagonal Gaussian, clamps it to the bounds, rolls it out, and fits the
/// next Gaussian to the elites (unbiased standard deviation, no less than the floor). Candidates whose cost is not
/// finite are never elites and never returned. One seed, one plan.
#[derive(Clone, Debug)]
pub struct Cem {
    settings: CemSettings,
    bounds: Vec<(f32, f32)>,
}

/// State of one search.
struct Search {
    rng: ChaCha8Rng,
    mean: Vec<f32>,
    std: Vec<f32>,
    best: Option<(f32, Vec<f32>)>,
    found: PlannedActions,
}

impl Cem {
    /// A search over actions of `bounds.len()` values, each within its (least, greatest) in model units.
    ///
    /// # Errors
    /// [`PlanError::Setting`] names what cannot serve.
    pub fn new(settings: CemSettings, bounds: &[(f32, f32)]) -> Result<Self, PlanError> {
        settings.validate()?;
        if bounds.is_empty() {
            return Err(PlanError::Setting(
                "no bounds: nothing to search over".into(),
            ));
        }
        for (index, (low, high)) in bounds.iter().enumerate() {
            if !(low.is_finite() && high.is_finite() && low <= high) {
                return Err(PlanError::Setting(format!(
                    "bounds {low}..{high} of value {index} must be finite and ascending"
                )));
            }
        }
        Ok(Self {
            settings,
            bounds: bounds.to_vec(),
        })
    }

    /// The settings.
    pub fn settings(&self) -> &CemSettings {
        &self.settings
    }

    /// Lower and upper bound of each searched value, in model units.
    pub fn bounds(&self) -> &[(f32, f32)] {
        &self.bounds
    }

    /// Searches for actions that bring `dynamics` to `target`.
    ///
    /// `start` is the first mean, one action a step ([`PlannedActions::without`] of the last plan); zeros without it.
    /// `out_of_time` is asked before each batch of candidates but the first, so that there is a plan however late it is.
    ///
    /// # Errors
    /// [`PlanError::Setting`] where `start` does not fit, [`PlanError::NoFiniteCost`], and the model's own.
    pub fn plan(
        &self,
        dynamics: &mut dyn Dynamics,
        target: &Target,
        start: Option<&[Vec<f32>]>,
        seed: u64,
        out_of_time: &mut dyn FnMut() -> bool,
    ) -> Result<PlannedActions, PlanError> {
        let mut search = Search {
            rng: ChaCha8Rng::seed_from_u64(seed),
            mean: self.first_mean(start)?,
            std: self.first_std(),
            best: None,
            found: PlannedActions {
                actions: Vec::new(),
                cost: f32::NAN,
                iteration_costs: Vec::with_capacity(self.settings.iterations),
                candidates: 0,
                rejected: 0,
                deadline_cut: false,
            },
        };
        for iteration in 1..=self.settings.iterations {
            if iteration > 1 && out_of_time() {
                search.found.deadline_cut = true;
                break;
            }
            self.iterate(iteration, &mut search, dynamics, target, out_of_time)?;
            if search.found.deadline_cut {
                break;
            }
        }
        self.choose(search, dynamics, target)
    }

    fn iterate(
        &self,
        iteration: usize,
        search: &mut Search,
        dynamics: &mut dyn Dynamics,
        target: &Target,
        out_of_time: &mut dyn FnMut() -> bool,
    ) -> Result<(), PlanError> {
        // All are drawn before any is rolled out, so that the batch size does not change the plan.
        let population: Vec<Vec<f32>> = (0..self.settings.population)
            .map(|_| self.draw(search))
            .collect();
        let mut scored: Vec<(f32, &Vec<f32>)> = Vec::with_capacity(population.len());
        let mut tried = 0;
        for (index, batch) in population.chunks(self.settings.batch).enumerate() {
            if index > 0 && out_of_time() {
                search.found.deadline_cut = true;
                break;
            }
            let costs =
                target.costs(&dynamics.rollout(&self.tensor(batch, dynamics.action_dim())?)?)?;
            tried += batch.len();
            scored.extend(
                costs
                    .into_iter()
                    .zip(batch)
                    .filter(|(cost, _)| cost.is_finite()),
            );
        }
        search.found.candidates += tried;
        search.found.rejected += tried - scored.len();

        // The sort is stable: equal costs keep the order in which they were drawn.
        scored.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let Some((least, best)) = scored.first() else {
            return Err(PlanError::NoFiniteCost {
                iteration,
                candidates: tried,
            });
        };
        search.found.iteration_costs.push(*least);
        if search.best.as_ref().is_none_or(|(cost, _)| least < cost) {
            search.best = Some((*least, (*best).clone()));
        }
        scored.truncate(self.settings.elites);
        // One elite, where the others were cut off or not finite, says nothing about the spread.
        if scored.len() > 1 {
            fit(
                &scored,
                self.settings.std_floor,
                &mut search.mean,
                &mut search.std,
            );
        }
        Ok(())
    }

    fn choose(
        &self,
        search: Search,
        dynamics: &mut dyn Dynamics,
        target: &Target,
    ) -> Result<PlannedActions, PlanError> {
        let Search {
            mut found,
            best,
            mean,
            ..
        } = search;
        let (mut cost, mut flat) = best.ok_or(PlanError::NoFiniteCost {
            iteration: 1,
            candidates: found.candidates,
        })?;
        if self.settings.returned == Returned::FinalMean {
            let mean = self.clamp(mean);
            let rolled = dynamics
                .rollout(&self.tensor(std::slice::from_ref(&mean), dynamics.action_dim())?)?;
            let mean_cost = target
                .costs(&rolled)?
                .into_iter()
                .next()
                .unwrap_or(f32::NAN);
            found.candidates += 1;
            if mean_cost.is_finite() {
                (cost, flat) = (mean_cost, mean);
            } else {
                found.rejected += 1;
            }
        }
        found.cost = cost;
        found.actions = flat
            .chunks_exact(self.bounds.len())
            .map(<[f32]>::to_vec)
            .collect();
        Ok(found)
    }

    fn first_mean(&self, start: Option<&[Vec<f32>]>) -> Result<Vec<f32>, PlanError> {
        let (horizon, values) = (self.settings.horizon, self.bounds.len());
        let Some(start) = start else {
            return Ok(self.clamp(vec![0.0; horizon * values]));
        };
        if start.len() != horizon || start.iter().any(|action| action.len() != values) {
            return Err(PlanError::Setting(format!(
                "the start must be {horizon} actions of {values} values, not {} of {:?}",
                start.len(),
                start.first().map(Vec::len)
            )));
        }
        if start.iter().flatten().any(|value| !value.is_finite()) {
            return Err(PlanError::Setting(
                "the start holds a value that is not finite".into(),
            ));
        }
        Ok(self.clamp(start.concat()))
    }

    fn first_std(&self) -> Vec<f32> {
        let floor = self.settings.std_floor;
        let of_range =
            |(low, high): &(f32, f32)| ((high - low) * self.settings.initial_std).max(floor);
        self.bounds
            .iter()
            .cycle()
            .take(self.settings.horizon * self.bounds.len())
            .map(of_range)
            .collect()
    }

    fn draw(&self, search: &mut Search) -> Vec<f32> {
        let mut candidate = Vec::with_capacity(search.mean.len());
        for (mean, std) in search.mean.iter().zip(&search.std) {
            let normal: f32 = StandardNormal.sample(&mut search.rng);
            candidate.push(mean + std * normal);
        }
        self.clamp(candidate)
    }

    fn clamp(&self, mut flat: Vec<f32>) -> Vec<f32> {
        for (value, (low, high)) in flat.iter_mut().zip(self.bounds.iter().cycle()) {
            *value = value.clamp(*low, *high);
        }
        flat
    }

    /// Candidates as (N, k, A), zeros beyond the searched values.
    fn tensor(&self, candidates: &[Vec<f32>], action_dim: usize) -> Result<Tensor, PlanError> {
        let values = self.bounds.len();
        if action_dim < values {
            return Err(PlanError::Setting(format!(
                "the model's actions have {action_dim} values, fewer than the {values} searched"
            )));
        }
        let mut data = Vec::with_capacity(candidates.len() * self.settings.horizon * action_dim);
        for action in candidates
            .iter()
            .flat_map(|candidate| candidate.chunks_exact(values))
        {
            data.extend_from_slice(action);
            data.resize(data.len() + action_dim - values, 0.0);
        }
        let shape = (candidates.len(), self.settings.horizon, action_dim);
        Ok(Tensor::from_vec(data, shape, &Device::Cpu)?)
    }
}

/// Mean and unbiased standard deviation of at least two elites; sums in f64.
fn fit(elites: &[(f32, &Vec<f32>)], floor: f32, mean: &mut [f32], std: &mut [f32]) {
    // Counts stay far below 2^52.
    let count = elites.len() as f64;
    for (index, (mean, std)) in mean.iter_mut().zip(std).enumerate() {
        let values = || {
            elites
                .iter()
                .filter_map(|(_, elite)| elite.get(index))
                .map(|value| f64::from(*value))
        };
        let centre = values().sum::<f64>() / count;
        let variance = values().map(|value| (value - centre).powi(2)).sum::<f64>() / (count - 1.0);
        *mean = centre as f32;
        *std = (variance.sqrt() as f32).max(floor);
    }
}

#[cfg(test)]
mod tests;
