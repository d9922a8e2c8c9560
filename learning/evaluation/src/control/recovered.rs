use anyhow::{Context as _, Result};
use candle_core::Tensor;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use wm_planner::{
    Cem, CemSettings, Dynamics as _, Objective, Planner as _, Problem, Returned, SearchSpace,
    Target, TransitionDynamics,
};

use crate::{Settings, Subject, Windows};

/// Candidates that are rolled out at once.
const BATCH: usize = 64;

/// The searches in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovered {
    /// Names of the dimensions that are searched.
    pub dimensions: Vec<String>,
    /// Steps that are searched together.
    pub k: usize,
    /// Cost at the true actions.
    pub cost_of_truth: f64,
    /// Error of actions drawn evenly within the bounds.
    pub random_error: f64,
    /// Error of no motion.
    pub zero_error: f64,
    /// Error of what the inverse dynamics model tells from the same latents; `None` without one of this many steps.
    pub told_error: Option<f64>,
    /// The searches.
    pub searches: Vec<Search>,
}

/// Where a search starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Start {
    /// At the true actions: the paper's.
    Truth,
    /// At zero: what a planner on a robot knows.
    Zero,
}

/// A search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Search {
    /// Where it started.
    pub start: Start,
    /// Mean over the steps of the distance to the true action.
    pub error: f64,
    /// Mean over the steps of the absolute error of each dimension.
    pub by_dimension: Vec<f64>,
    /// Cost of what was found.
    pub cost: f64,
    /// Least cost of each iteration.
    pub iteration_costs: Vec<f64>,
}

/// Searches for the actions of window `unit`, k steps together, from every start.
pub(super) fn measure(
    subject: &Subject,
    settings: &Settings,
    windows: &Windows,
    (unit, k): (usize, usize),
) -> Result<Recovered> {
    let own = &settings.control;
    let values = subject.world.encoding.space().len();
    // One noise a window, which all candidates of all searches share; another seed for each window.
    let seed = settings.seed.wrapping_add(unit as u64);
    let (context, past) = windows.context(unit)?;
    let told = windows.actions(unit)?;
    let target = Target::EachStep(windows.coming(unit)?.narrow(0, 0, k)?.contiguous()?);
    let model = &subject.world.transition;
    // The last predicted frame carries the action that was recorded there, which is not searched (architecture.md,
    // section 2: it never saw zeros in training).
    let after = told.narrow(0, k, 1)?;
    let mut dynamics =
        TransitionDynamics::new(model, subject.sampler(), &context, Some(&past), seed)?
            .ending_with(&after)?;
    let truth: Vec<Vec<f32>> = told.narrow(0, 0, k)?.narrow(1, 0, values)?.to_vec2()?;

    let settings_of = CemSettings {
        population: own.population,
        iterations: own.iterations,
        elites: own.elites,
        initial_std: own.initial_std,
        returned: Returned::BestSeen,
        ..CemSettings::default()
    };
    let bounds = vec![(-own.bound, own.bound); values];
    let cem = Cem::new(settings_of)?;
    let space = SearchSpace::bounded(&bounds, dynamics.action_dim())?;
    let objective = Objective::of(target.clone());
    let mut searches = Vec::new();
    for start in [Start::Truth, Start::Zero] {
        let mut problem = Problem {
            space: &space,
            dynamics: &mut dynamics,
            objective: &objective,
            horizon: k,
            batch: BATCH,
            proposals: match start {
                Start::Truth => vec![truth.clone()],
                Start::Zero => Vec::new(),
            },
            workers: None,
        };
        let plan = cem.plan(&mut problem, seed, &mut |_| false)?;
        searches.push(Search {
            start,
            error: error(&plan.actions, &truth),
            by_dimension: by_dimension(&plan.actions, &truth),
            cost: f64::from(plan.cost),
            iteration_costs: plan.iteration_costs.iter().map(|c| f64::from(*c)).collect(),
        });
    }
    let rolled = dynamics.rollout(&told.narrow(0, 0, k)?.unsqueeze(0)?.contiguous()?)?;
    let cost = target.costs(&rolled)?.first().copied();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let random: Vec<Vec<f32>> = (0..k)
        .map(|_| {
            let drawn = (0..values).map(|_| rng.random_range(-own.bound..=own.bound));
            drawn.collect()
        })
        .collect();
    let space = subject.world.encoding.space();
    Ok(Recovered {
        dimensions: space.dimensions().iter().map(|d| d.name.clone()).collect(),
        k,
        cost_of_truth: cost.map(f64::from).context("no cost of the true actions")?,
        random_error: error(&random, &truth),
        zero_error: error(&vec![vec![0.0; values]; k], &truth),
        told_error: told_by_idm(subject, windows, unit, k)?.map(|told| error(&told, &truth)),
        searches,
    })
}

/// What an inverse dynamics model of k steps tells from the observed latents.
fn told_by_idm(
    subject: &Subject,
    windows: &Windows,
    unit: usize,
    k: usize,
) -> Result<Option<Vec<Vec<f32>>>> {
    let mut idms = subject.readers.idms.iter();
    let Some(idm) = idms.find(|idm| idm.model.idm().horizon() == k) else {
        return Ok(None);
    };
    let coming = windows.coming(unit)?.narrow(0, 0, k)?;
    let frames = Tensor::cat(&[windows.last_observed(unit)?, coming], 0)?;
    let frames = idm.latents(&frames)?;
    let told = idm.model.actions(&frames.unsqueeze(0)?)?.squeeze(0)?;
    let values = subject.world.encoding.space().len();
    Ok(Some(told.narrow(1, 0, values)?.to_vec2()?))
}

/// Mean over the steps of the L2 norm over all dimensions (the paper's CEM error).
fn error(found: &[Vec<f32>], truth: &[Vec<f32>]) -> f64 {
    let steps = found.iter().zip(truth).map(|(found, truth)| {
        let pairs = found.iter().zip(truth);
        let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        squares.sqrt()
    });
    steps.sum::<f64>() / truth.len().max(1) as f64
}

fn by_dimension(found: &[Vec<f32>], truth: &[Vec<f32>]) -> Vec<f64> {
    let values = truth.first().map_or(0, Vec::len);
    let mut sums = vec![0.0; values];
    for (found, truth) in found.iter().zip(truth) {
        for (sum, (a, b)) in sums.iter_mut().zip(found.iter().zip(truth)) {
            *sum += f64::from((a - b).abs());
        }
    }
    let steps = truth.len().max(1) as f64;
    sums.iter().map(|sum| sum / steps).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_means_over_steps() {
        let truth = [vec![0.0, 0.0], vec![1.0, 1.0]];
        let found = [vec![3.0, 4.0], vec![1.0, 0.0]];
        assert_eq!(error(&found, &truth), 3.0);
        assert_eq!(by_dimension(&found, &truth), [1.5, 2.5]);
    }
}
