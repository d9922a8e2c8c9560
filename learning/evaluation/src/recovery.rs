//! Whether plans recover the true action.

use std::fmt;

use anyhow::{Context as _, Result};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use wm_model::transition::LoadedTransition;
use wm_motion::actions::ActionEncoding;
use wm_planner::{
    Cem, CemSettings, Objective, Planner as _, Problem, Returned, SearchSpace, Target,
    TransitionDynamics,
};

use crate::windows::{CONTEXT, SEED, Window, Windows};

/// Recovery of the true action by one-step plans that start from zero, in model units.
#[derive(Clone, Debug, PartialEq)]
pub struct Recovery {
    /// Plans made.
    pub plans: usize,
    /// Mean distance over the three translations: of the plan, of no motion, of a random guess within the bounds.
    pub translation: [f64; 3],
    /// Mean distances over the three rotations.
    pub rotation: [f64; 3],
    /// Share of the plans with the gripper's true sign (0.5 for random guesses); `None` without a gripper.
    pub gripper: Option<f64>,
    /// Number of plans for steps with a gripper command that changes.
    pub moves: usize,
    /// Share of these with the gripper's true sign; `None` without any.
    pub gripper_of_moves: Option<f64>,
}

impl fmt::Display for Recovery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} one-step plans from zero, distance to the true action:",
            self.plans
        )?;
        for (name, [plan, zero, random]) in [("xyz", self.translation), ("rotation", self.rotation)]
        {
            writeln!(
                f,
                "  {name:<9} plan {plan:.3}, no motion {zero:.3}, random {random:.3}: {:.3} of random",
                plan / random
            )?;
        }
        let Some(gripper) = self.gripper else {
            return write!(f, "  no gripper");
        };
        write!(f, "  gripper of the right sign in {:.0} %", 100.0 * gripper)?;
        match self.gripper_of_moves {
            Some(part) => write!(
                f,
                "; in {:.0} % of {} steps with a gripper motion",
                100.0 * part,
                self.moves
            ),
            None => write!(f, "; it never moves"),
        }
    }
}

/// Index of the gripper in an end effector action.
const GRIPPER: usize = 6;

/// Plans one step to the next observed latent, from each of `plans` windows, and from as many steps with a gripper
/// motion.
///
/// # Errors
/// If the model does not fit the latents.
/// When the model does not fit the latents.
pub fn recover_actions(
    model: &LoadedTransition,
    encoding: &ActionEncoding,
    windows: &Windows,
    plans: usize,
) -> Result<Recovery> {
    let bounds = encoding.bounds();
    let settings = CemSettings {
        // As many candidates as the paper's search, which starts at the true action. From zero, more iterations of fewer
        // candidates come nearer.
        population: 200,
        iterations: 10,
        elites: 20,
        initial_std: 0.2,
        returned: Returned::FinalMean,
        ..CemSettings::default()
    };
    let cem = Cem::new(settings)?;
    let space = SearchSpace::bounded(&bounds, encoding.action_dim())?;
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let (mut translation, mut rotation) = ([0.0; 3], [0.0; 3]);
    let mut right = Vec::new();
    let cases = some_of(windows.all.iter().collect(), plans);
    for case in &cases {
        let (planned, truth) = plan(model, (&cem, &space), case, CONTEXT - 1)?;
        let random: Vec<f32> = bounds
            .iter()
            .map(|(low, high)| rng.random_range(*low..=*high))
            .collect();
        let zero = vec![0.0; truth.len()];
        for (i, guess) in [&planned, &zero, &random].into_iter().enumerate() {
            translation[i] += distance(guess, &truth, 0..3) / cases.len() as f64;
            rotation[i] += distance(guess, &truth, 3..6) / cases.len() as f64;
        }
        right.extend(is_right(&planned, &truth));
    }
    let moves = some_of(moves(&windows.all)?, plans);
    let mut right_of_moves = Vec::new();
    for (case, step) in &moves {
        let (planned, truth) = plan(model, (&cem, &space), case, *step)?;
        right_of_moves.extend(is_right(&planned, &truth));
    }
    Ok(Recovery {
        plans: cases.len(),
        translation,
        rotation,
        gripper: part(&right),
        moves: moves.len(),
        gripper_of_moves: part(&right_of_moves),
    })
}

/// At most `count`, evenly spread.
fn some_of<T>(all: Vec<T>, count: usize) -> Vec<T> {
    let stride = (all.len() / count.max(1)).max(1);
    all.into_iter().step_by(stride).take(count).collect()
}

/// Steps whose gripper command differs from the previous one.
fn moves(cases: &[Window]) -> Result<Vec<(&Window, usize)>> {
    let mut moves = Vec::new();
    for case in cases {
        let actions = case.actions.to_vec2::<f32>()?;
        for (step, pair) in (1..).zip(actions.windows(2)) {
            let [before, now] = pair else { continue };
            // The last action leads out of the window.
            let is_inside = step + 1 >= CONTEXT && step + 1 < case.frames.dim(0)?;
            if is_inside && is_right(before, now) == Some(false) {
                moves.push((case, step));
            }
        }
    }
    Ok(moves)
}

/// The planned action from the frames up to `step` of a window to the next, and the true one.
fn plan(
    model: &LoadedTransition,
    (cem, space): (&Cem, &SearchSpace),
    case: &Window,
    step: usize,
) -> Result<(Vec<f32>, Vec<f32>)> {
    let first = step + 1 - CONTEXT;
    let context = case.frames.narrow(0, first, CONTEXT)?.unsqueeze(0)?;
    let past = case.actions.narrow(0, first, CONTEXT - 1)?;
    let sampler = &model.config().sampler;
    let mut dynamics = TransitionDynamics::new(model, sampler, &context, Some(&past), SEED)?;
    let target = Target::EachStep(case.frames.narrow(0, step + 1, 1)?);
    let mut problem = Problem {
        space,
        dynamics: &mut dynamics,
        objective: &Objective::of(target),
        horizon: 1,
        batch: 100,
        proposals: Vec::new(),
        workers: None,
    };
    let plan = cem.plan(&mut problem, SEED, &mut |_| false)?;
    let planned = plan.actions.into_iter().next();
    let truth = case.actions.get(step)?.to_vec1::<f32>()?;
    Ok((planned.context("a plan without actions")?, truth))
}

/// Whether two actions have the same gripper command; `None` without a gripper.
fn is_right(planned: &[f32], truth: &[f32]) -> Option<bool> {
    let (planned, truth) = (planned.get(GRIPPER)?, truth.get(GRIPPER)?);
    Some((*planned > 0.0) == (*truth > 0.0))
}

fn part(right: &[bool]) -> Option<f64> {
    let count = right.iter().filter(|right| **right).count();
    (!right.is_empty()).then(|| count as f64 / right.len() as f64)
}

fn distance(a: &[f32], b: &[f32], part: std::ops::Range<usize>) -> f64 {
    let pairs = a.iter().zip(b).skip(part.start).take(part.len());
    let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    squares.sqrt()
}

#[cfg(test)]
mod tests {
    use candle_core::{DType, Device, Tensor};

    use super::*;

    #[test]
    fn gripper_moves_are_found_after_the_observed_frames() {
        let gripper = [1.0f32, -1.0, -1.0, 0.5, -0.2];
        let action = |gripper: f32| [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, gripper];
        let actions = Tensor::new(&gripper.map(action), &Device::Cpu).unwrap();
        let frames = Tensor::zeros((5, 1, 1, 1), DType::F32, &Device::Cpu).unwrap();
        let case = Window {
            episode: 0,
            first_frame: 0,
            frames,
            actions,
        };
        let cases = [case];
        let found = moves(&cases).unwrap();
        let steps: Vec<usize> = found.iter().map(|(_, step)| *step).collect();
        assert_eq!(steps, [1, 3]);
        assert_eq!(some_of((0..10).collect(), 4), [0, 2, 4, 6]);
    }
}
