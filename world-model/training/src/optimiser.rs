//! What both trainings step with: AdamW with decoupled weight decay, clipping by the global norm, an exponential moving
//! average of the weights, and a learning rate that warms up and then follows a cosine.
//!
//! The state is plain `f32` buffers in the order of the parameters' names; randomness is derived from (seed, step)
//! (see [`step_rng`]), so that a checkpoint is the buffers and the step alone, and a resumed run equals an
//! uninterrupted one bit for bit.

mod checkpoint;
mod schedule;

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor, Var, backprop::GradStore};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use schedule::Schedule;

/// Why an optimiser step, or a checkpoint, was refused.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OptimiserError {
    /// A parameter got no gradient: some operation on its way to the loss does not propagate one.
    #[error(
        "parameter `{0}` got no gradient: an operation between it and the loss drops gradients"
    )]
    NoGradient(String),
    /// The gradient holds a NaN or an infinity.
    #[error(
        "the gradient of step {step} is not finite (norm {norm}); first in parameter `{parameter}`"
    )]
    NotFinite {
        /// The step, from 0.
        step: u64,
        /// The global norm.
        norm: f64,
        /// The first parameter, by name, whose gradient is not finite.
        parameter: String,
    },
    /// A checkpoint does not fit the model.
    #[error("checkpoint {path}: {what}")]
    Checkpoint {
        /// The file.
        path: String,
        /// What was expected and what came.
        what: String,
    },
    /// A tensor operation failed.
    #[error(transparent)]
    Tensor(#[from] candle_core::Error),
}

/// Settings of [`AdamW`]; the defaults are the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdamWSettings {
    /// Decay of the first moment.
    pub beta1: f64,
    /// Decay of the second moment.
    pub beta2: f64,
    /// Added to the root of the second moment.
    pub epsilon: f64,
    /// Decoupled weight decay, multiplied by the learning rate.
    pub weight_decay: f64,
    /// The gradient is scaled down to this global norm.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights; early steps use (1 + t) / (10 + t) where that is smaller.
    pub ema_decay: f64,
}

impl Default for AdamWSettings {
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.99,
            epsilon: 1e-8,
            weight_decay: 2e-3,
            clip_norm: 1.0,
            ema_decay: 0.9995,
        }
    }
}

struct Parameter {
    name: String,
    var: Var,
    weights: Vec<f32>,
    first_moment: Vec<f32>,
    second_moment: Vec<f32>,
    ema: Vec<f32>,
}

/// The optimiser and its state.
pub struct AdamW {
    settings: AdamWSettings,
    parameters: Vec<Parameter>,
    step: u64,
}

impl AdamW {
    /// An optimiser of `vars` (f32, by name), at step 0, whose moving average starts at the present weights.
    ///
    /// # Errors
    /// When a variable is not f32.
    pub fn new(
        vars: &BTreeMap<String, Var>,
        settings: AdamWSettings,
    ) -> Result<Self, OptimiserError> {
        let parameters = vars
            .iter()
            .map(|(name, var)| {
                let weights = var.flatten_all()?.to_vec1::<f32>()?;
                Ok(Parameter {
                    name: name.clone(),
                    var: var.clone(),
                    first_moment: vec![0.0; weights.len()],
                    second_moment: vec![0.0; weights.len()],
                    ema: weights.clone(),
                    weights,
                })
            })
            .collect::<Result<_, OptimiserError>>()?;
        Ok(Self {
            settings,
            parameters,
            step: 0,
        })
    }

    /// Steps taken so far.
    #[must_use]
    pub fn steps_taken(&self) -> u64 {
        self.step
    }

    /// One step along `gradients` with `learning_rate`; gives the gradient's global norm before clipping.
    ///
    /// # Errors
    /// When a parameter has no gradient, or one that is not finite; nothing is changed then.
    pub fn step(
        &mut self,
        gradients: &GradStore,
        learning_rate: f64,
    ) -> Result<f64, OptimiserError> {
        let gradients = self
            .parameters
            .iter()
            .map(|parameter| {
                let gradient = gradients
                    .get(&parameter.var)
                    .ok_or_else(|| OptimiserError::NoGradient(parameter.name.clone()))?;
                Ok(gradient
                    .flatten_all()?
                    .to_dtype(DType::F32)?
                    .to_vec1::<f32>()?)
            })
            .collect::<Result<Vec<_>, OptimiserError>>()?;
        self.step_along(&gradients, learning_rate)
    }

    /// As [`Self::step`], along plain buffers: one for each variable, in the order of the names, in row-major order.
    ///
    /// # Errors
    /// When a gradient is missing, has another length than its variable or is not finite; nothing is changed then.
    pub fn step_along(
        &mut self,
        gradients: &[Vec<f32>],
        learning_rate: f64,
    ) -> Result<f64, OptimiserError> {
        for (index, parameter) in self.parameters.iter().enumerate() {
            if gradients.get(index).map(Vec::len) != Some(parameter.weights.len()) {
                return Err(OptimiserError::NoGradient(parameter.name.clone()));
            }
        }
        let squares: Vec<f64> = gradients
            .par_iter()
            .map(|gradient| gradient.iter().map(|g| f64::from(*g) * f64::from(*g)).sum())
            .collect();
        let norm = squares.iter().sum::<f64>().sqrt();
        if !norm.is_finite() {
            let parameter = self
                .parameters
                .iter()
                .zip(&squares)
                .find(|(_, square)| !square.is_finite())
                .map(|(parameter, _)| parameter.name.clone())
                .unwrap_or_default();
            return Err(OptimiserError::NotFinite {
                step: self.step,
                norm,
                parameter,
            });
        }

        self.step += 1;
        let settings = &self.settings;
        let step = self.step as f64;
        let scale = (settings.clip_norm / norm.max(f64::MIN_POSITIVE)).min(1.0) as f32;
        let (beta1, beta2) = (settings.beta1 as f32, settings.beta2 as f32);
        let first_correction = (1.0 - settings.beta1.powf(step)) as f32;
        let second_correction = (1.0 - settings.beta2.powf(step)) as f32;
        let decay = (1.0 - learning_rate * settings.weight_decay) as f32;
        let rate = learning_rate as f32 / first_correction;
        let epsilon = settings.epsilon as f32;
        let ema_decay = settings.ema_decay.min((1.0 + step) / (10.0 + step)) as f32;
        self.parameters
            .par_iter_mut()
            .zip(gradients.par_iter())
            .for_each(|(parameter, gradient)| {
                let moments = parameter
                    .first_moment
                    .iter_mut()
                    .zip(&mut parameter.second_moment);
                let averaged = parameter.weights.iter_mut().zip(&mut parameter.ema);
                for (((weight, ema), (first, second)), gradient) in
                    averaged.zip(moments).zip(gradient)
                {
                    let gradient = gradient * scale;
                    *first = beta1 * *first + (1.0 - beta1) * gradient;
                    *second = beta2 * *second + (1.0 - beta2) * gradient * gradient;
                    let root = (*second / second_correction).sqrt() + epsilon;
                    *weight = *weight * decay - rate * *first / root;
                    *ema = ema_decay * *ema + (1.0 - ema_decay) * *weight;
                }
            });
        self.write_back()?;
        Ok(norm)
    }

    /// Every variable's weights in row-major order, in the order of the names.
    pub fn weights(&self) -> impl Iterator<Item = (&str, &[f32])> {
        self.parameters
            .iter()
            .map(|parameter| (parameter.name.as_str(), parameter.weights.as_slice()))
    }

    /// The moving average of every weight, by name, in the shapes of the variables.
    ///
    /// # Errors
    /// When a tensor cannot be made.
    pub fn ema(&self) -> Result<BTreeMap<String, Tensor>, OptimiserError> {
        self.parameters
            .iter()
            .map(|parameter| {
                let tensor =
                    Tensor::from_slice(&parameter.ema, parameter.var.shape(), &Device::Cpu)?;
                Ok((parameter.name.clone(), tensor))
            })
            .collect()
    }

    fn write_back(&self) -> Result<(), OptimiserError> {
        for parameter in &self.parameters {
            let tensor =
                Tensor::from_slice(&parameter.weights, parameter.var.shape(), &Device::Cpu)?;
            parameter.var.set(&tensor)?;
        }
        Ok(())
    }
}

/// The random numbers of step `step`: a stream of its own for each, so that a resumed run draws what an uninterrupted
/// one would.
#[must_use]
pub fn step_rng(seed: u64, step: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(step);
    rng
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quadratic() -> (BTreeMap<String, Var>, Var) {
        let var = Var::new(&[3f32, -2., 0.5], &Device::Cpu).unwrap();
        (BTreeMap::from([("w".to_owned(), var.clone())]), var)
    }

    fn descend(optimiser: &mut AdamW, var: &Var, steps: u64, schedule: &Schedule) {
        for _ in 0..steps {
            let loss = var.sqr().unwrap().sum_all().unwrap();
            let rate = schedule.at(optimiser.steps_taken());
            optimiser.step(&loss.backward().unwrap(), rate).unwrap();
        }
    }

    #[test]
    fn one_step_is_adamw_worked_by_hand() {
        let (vars, var) = quadratic();
        let settings = AdamWSettings {
            clip_norm: 1e9,
            ..Default::default()
        };
        let mut optimiser = AdamW::new(&vars, settings).unwrap();
        let loss = var.sqr().unwrap().sum_all().unwrap();
        let norm = optimiser.step(&loss.backward().unwrap(), 0.1).unwrap();
        assert!((norm - (36f64 + 16. + 1.).sqrt()).abs() < 1e-5);
        // After bias correction the first step has length lr in the direction of the sign.
        let expected = [3., -2., 0.5].map(|w: f32| w * (1. - 0.1 * 2e-3) - 0.1 * w.signum());
        for (weight, expected) in var.to_vec1::<f32>().unwrap().iter().zip(expected) {
            assert!((weight - expected).abs() < 1e-6, "{weight} {expected}");
        }
    }

    #[test]
    fn a_resumed_run_equals_the_uninterrupted_one() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.safetensors");
        let schedule = Schedule::new(0.1, 5, 40, 0.1);
        let (vars, var) = quadratic();
        let mut whole = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        descend(&mut whole, &var, 20, &schedule);
        whole.save(&path, "run 1").unwrap();
        descend(&mut whole, &var, 20, &schedule);

        let (vars, resumed_var) = quadratic();
        let mut resumed = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        resumed.resume(&path, "run 1").unwrap();
        assert_eq!(resumed.steps_taken(), 20);
        descend(&mut resumed, &resumed_var, 20, &schedule);
        assert_eq!(
            var.to_vec1::<f32>().unwrap(),
            resumed_var.to_vec1::<f32>().unwrap()
        );
        assert_eq!(
            whole.ema().unwrap()["w"].to_vec1::<f32>().unwrap(),
            resumed.ema().unwrap()["w"].to_vec1::<f32>().unwrap()
        );
    }

    #[test]
    fn a_checkpoint_of_another_run_or_shape_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.safetensors");
        let (vars, _) = quadratic();
        AdamW::new(&vars, AdamWSettings::default())
            .unwrap()
            .save(&path, "run 1")
            .unwrap();
        let mut same = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        let error = same.resume(&path, "run 2").unwrap_err().to_string();
        assert!(
            error.contains("run 1") && error.contains("run 2"),
            "{error}"
        );
        let wider = Var::new(&[0f32; 4], &Device::Cpu).unwrap();
        let vars = BTreeMap::from([("w".to_owned(), wider)]);
        let mut other = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        let error = other.resume(&path, "run 1").unwrap_err().to_string();
        assert!(error.contains("`w`"), "{error}");
        std::fs::write(&path, b"noise").unwrap();
        assert!(same.resume(&path, "run 1").is_err());
    }

    #[test]
    fn a_parameter_without_gradient_and_a_nan_are_named() {
        let (mut vars, var) = quadratic();
        vars.insert("idle".into(), Var::new(&[1f32], &Device::Cpu).unwrap());
        let mut optimiser = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        let loss = var.sqr().unwrap().sum_all().unwrap();
        let error = optimiser.step(&loss.backward().unwrap(), 0.1).unwrap_err();
        assert!(error.to_string().contains("`idle`"));

        let (vars, var) = quadratic();
        let mut optimiser = AdamW::new(&vars, AdamWSettings::default()).unwrap();
        let loss = var.affine(f64::NAN, 0.).unwrap().sum_all().unwrap();
        let error = optimiser.step(&loss.backward().unwrap(), 0.1).unwrap_err();
        assert!(error.to_string().contains("`w`"));
        assert_eq!(optimiser.steps_taken(), 0);
    }
}
