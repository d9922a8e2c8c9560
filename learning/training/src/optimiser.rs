//! The optimiser of every training: AdamW with decoupled weight decay, clipping by the global norm, an exponential
//! moving average of the weights, and a learning rate with warm-up and cosine decay.
//!
//! The state is plain `f32` buffers in the order of the parameters. Random numbers depend on (seed, step) only (see
//! [`step_rng`]). So a checkpoint consists of the buffers and the step, and a resumed run equals an uninterrupted one
//! bit for bit.

mod checkpoint;
mod schedule;
mod variables;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub(crate) use checkpoint::differences;
pub use schedule::Schedule;
pub use variables::Variables;

/// A rejected optimiser step or checkpoint.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum OptimiserError {
    /// A parameter without gradient: some operation on its path to the loss drops it.
    #[error(
        "parameter `{0}` got no gradient: an operation between it and the loss drops gradients"
    )]
    NoGradient(String),
    /// A gradient with a NaN or an infinity.
    #[error(
        "the gradient of step {step} is not finite (norm {norm}); first in parameter `{parameter}`"
    )]
    NotFinite {
        /// Step, from 0.
        step: u64,
        /// Global norm.
        norm: f64,
        /// The first parameter, by name, with such a gradient.
        parameter: String,
    },
    /// A checkpoint of other settings or data.
    #[error("{path} is the checkpoint of another training:{}", listed(.differences))]
    OtherTraining {
        /// Path of the file.
        path: String,
        /// Differences, one per line.
        differences: Vec<String>,
    },
    /// A checkpoint that does not fit the model.
    #[error("checkpoint {path}: {what}")]
    Checkpoint {
        /// Path of the file.
        path: String,
        /// Expected and found.
        what: String,
    },
}

fn listed(lines: &[String]) -> String {
    lines.iter().map(|line| format!("\n  {line}")).collect()
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
    /// Greatest global norm of the gradient.
    pub clip_norm: f64,
    /// Decay of the moving average of the weights; early steps use (1 + t) / (10 + t) if smaller.
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

/// A trained tensor at step 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name, as in the weights file.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f32>,
    /// Index of its [`Group`].
    pub group: usize,
}

/// Parameters with their own learning rate and gradient clipping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// Factor on the learning rate.
    pub rate: f64,
}

impl Default for Group {
    fn default() -> Self {
        Self { rate: 1.0 }
    }
}

/// Current values of a trained tensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterValues<'a> {
    /// Name, as in the weights file.
    pub name: &'a str,
    /// Shape.
    pub shape: &'a [usize],
    /// Values in row-major order.
    pub values: &'a [f32],
}

struct State {
    name: String,
    shape: Vec<usize>,
    group: usize,
    weights: Vec<f32>,
    first_moment: Vec<f32>,
    second_moment: Vec<f32>,
    ema: Vec<f32>,
}

/// The optimiser and its state.
pub struct AdamW {
    settings: AdamWSettings,
    groups: Vec<Group>,
    parameters: Vec<State>,
    step: u64,
    skipped: u64,
}

impl AdamW {
    /// [`Self::in_groups`] with one group.
    #[cfg(test)]
    pub(crate) fn new(parameters: Vec<Parameter>, settings: AdamWSettings) -> Self {
        Self::in_groups(parameters, vec![Group::default()], settings)
    }

    /// An optimiser of `parameters` at step 0, whose moving average starts at their values. Parameters of unknown groups
    /// belong to the last one.
    #[must_use]
    pub fn in_groups(
        parameters: Vec<Parameter>,
        groups: Vec<Group>,
        settings: AdamWSettings,
    ) -> Self {
        let last = groups.len().saturating_sub(1);
        let parameters = parameters.into_iter().map(|parameter| State {
            name: parameter.name,
            shape: parameter.shape,
            group: parameter.group.min(last),
            first_moment: vec![0.0; parameter.values.len()],
            second_moment: vec![0.0; parameter.values.len()],
            ema: parameter.values.clone(),
            weights: parameter.values,
        });
        Self {
            settings,
            groups,
            parameters: parameters.collect(),
            step: 0,
            skipped: 0,
        }
    }

    /// Steps so far, including skipped ones.
    #[must_use]
    pub fn steps_taken(&self) -> u64 {
        self.step
    }

    /// Skipped steps.
    #[must_use]
    pub fn steps_skipped(&self) -> u64 {
        self.skipped
    }

    /// Counts a step without effect, because its loss or gradient is not finite; the next one draws other samples.
    pub fn skip(&mut self) {
        self.step += 1;
        self.skipped += 1;
    }

    /// Steps along `gradients`, one per parameter in order, row-major; returns the global norm before clipping.
    ///
    /// # Errors
    /// If a gradient is missing, has another length than its parameter or is not finite; nothing changes then.
    pub fn step(
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
            // Without a name, only the sum of all squares is infinite.
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
        // Skipped steps have not changed the moments.
        let step = (self.step - self.skipped) as f64;
        let (beta1, beta2) = (settings.beta1 as f32, settings.beta2 as f32);
        let first_correction = (1.0 - settings.beta1.powf(step)) as f32;
        let second_correction = (1.0 - settings.beta2.powf(step)) as f32;
        let epsilon = settings.epsilon as f32;
        let ema_decay = settings.ema_decay.min((1.0 + step) / (10.0 + step)) as f32;
        // Per group: gradient scale, bias-corrected learning rate, weight decay.
        let of_groups: Vec<[f32; 3]> = (self.groups.iter().enumerate())
            .map(|(group, Group { rate })| {
                let own = self.parameters.iter().zip(&squares);
                let own = own.filter(|(parameter, _)| parameter.group == group);
                let norm = own.map(|(_, square)| square).sum::<f64>().sqrt();
                let scale = (settings.clip_norm / norm.max(f64::MIN_POSITIVE)).min(1.0);
                let rate = rate * learning_rate;
                [
                    scale as f32,
                    rate as f32 / first_correction,
                    (1.0 - rate * settings.weight_decay) as f32,
                ]
            })
            .collect();
        self.parameters
            .par_iter_mut()
            .zip(gradients.par_iter())
            .for_each(|(parameter, gradient)| {
                // `in_groups` has bounded the index; the default would change nothing.
                let of_group = of_groups.get(parameter.group).copied();
                let [scale, rate, decay] = of_group.unwrap_or([0.0, 0.0, 1.0]);
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
        Ok(norm)
    }

    /// Current values of all parameters, in order.
    pub fn weights(&self) -> impl Iterator<Item = ParameterValues<'_>> {
        self.parameters.iter().map(|parameter| ParameterValues {
            name: &parameter.name,
            shape: &parameter.shape,
            values: &parameter.weights,
        })
    }

    /// Moving averages of all parameters, in order.
    pub fn averaged(&self) -> impl Iterator<Item = ParameterValues<'_>> {
        self.parameters.iter().map(|parameter| ParameterValues {
            name: &parameter.name,
            shape: &parameter.shape,
            values: &parameter.ema,
        })
    }

    /// Number of trained values.
    #[must_use]
    pub fn parameter_count(&self) -> usize {
        let counts = self.parameters.iter().map(|state| state.weights.len());
        counts.sum()
    }
}

/// Random numbers of step `step`, an independent stream per step, so that resumed runs equal uninterrupted ones.
#[must_use]
pub fn step_rng(seed: u64, step: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(step);
    rng
}

#[cfg(test)]
mod parity;
#[cfg(test)]
mod tests {
    use super::*;

    use serde_json::json;

    fn at(values: &[f32]) -> Vec<Parameter> {
        vec![Parameter {
            name: "w".into(),
            shape: vec![values.len()],
            values: values.to_vec(),
            group: 0,
        }]
    }

    fn quadratic(settings: AdamWSettings) -> AdamW {
        AdamW::new(at(&[3., -2., 0.5]), settings)
    }

    fn now(optimiser: &AdamW) -> Vec<f32> {
        optimiser
            .weights()
            .flat_map(|w| w.values.to_vec())
            .collect()
    }

    /// Gradient of the sum of squares.
    fn slope(optimiser: &AdamW) -> Vec<Vec<f32>> {
        vec![now(optimiser).iter().map(|w| 2. * w).collect()]
    }

    fn descend(optimiser: &mut AdamW, steps: u64, schedule: &Schedule) {
        for _ in 0..steps {
            let rate = schedule.at(optimiser.steps_taken());
            optimiser.step(&slope(optimiser), rate).unwrap();
        }
    }

    #[test]
    fn step_matches_adamw_by_hand() {
        let mut optimiser = quadratic(AdamWSettings {
            clip_norm: 1e9,
            ..Default::default()
        });
        let norm = optimiser.step(&slope(&optimiser), 0.1).unwrap();
        assert!((norm - (36f64 + 16. + 1.).sqrt()).abs() < 1e-5);
        // With bias correction, the first step has length lr in the direction of the sign.
        let expected = [3., -2., 0.5].map(|w: f32| w * (1. - 0.1 * 2e-3) - 0.1 * w.signum());
        for (weight, expected) in now(&optimiser).iter().zip(expected) {
            assert!((weight - expected).abs() < 1e-6, "{weight} {expected}");
        }
    }

    #[test]
    fn groups_have_their_own_rate_and_clipping() {
        let mut parameters = at(&[1.]);
        parameters.extend(at(&[1.]).into_iter().map(|parameter| Parameter {
            name: "z".into(),
            group: 1,
            ..parameter
        }));
        let settings = AdamWSettings {
            weight_decay: 0.0,
            epsilon: 1.0,
            ..Default::default()
        };
        let groups = vec![Group::default(), Group { rate: 3.0 }];
        let mut optimiser = AdamW::in_groups(parameters, groups, settings);
        // The first is clipped to 1, the second stays.
        optimiser.step(&[vec![100.], vec![0.5]], 0.1).unwrap();
        let moved: Vec<f32> = now(&optimiser).iter().map(|w| 1. - w).collect();
        assert!((moved[0] - 0.1 / 2.).abs() < 1e-5, "{moved:?}");
        assert!((moved[1] - 0.3 * 0.5 / 1.5).abs() < 1e-5, "{moved:?}");
    }

    #[test]
    fn resumed_run_equals_the_uninterrupted_one() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.safetensors");
        let schedule = Schedule::new(0.1, 5, 40, 0.1);
        let mut whole = quadratic(AdamWSettings::default());
        descend(&mut whole, 20, &schedule);
        whole.skip();
        whole.save(&path, &json!({"seed": 1})).unwrap();
        descend(&mut whole, 20, &schedule);

        let mut resumed = quadratic(AdamWSettings::default());
        resumed.resume(&path, &json!({"seed": 1})).unwrap();
        assert_eq!((resumed.steps_taken(), resumed.steps_skipped()), (21, 1));
        descend(&mut resumed, 20, &schedule);
        assert_eq!(now(&whole), now(&resumed));
        let averaged = |run: &AdamW| run.averaged().flat_map(|w| w.values.to_vec()).collect();
        let (first, second): (Vec<f32>, Vec<f32>) = (averaged(&whole), averaged(&resumed));
        assert_eq!(first, second);
    }

    #[test]
    fn differences_from_a_checkpoint_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.safetensors");
        let mut optimiser = quadratic(AdamWSettings::default());
        optimiser
            .save(
                &path,
                &json!({"data": "a", "optimiser": {"rate": 0.1, "decay": 2}}),
            )
            .unwrap();
        let other = json!({"data": "a", "optimiser": {"rate": 0.2, "decay": 2}});
        let error = optimiser.resume(&path, &other).unwrap_err();
        let OptimiserError::OtherTraining { differences, .. } = &error else {
            panic!("{error}");
        };
        assert_eq!(
            differences,
            &["optimiser.rate: 0.1 in the checkpoint, 0.2 now"],
        );
        let run = json!({"data": "a", "optimiser": {"rate": 0.1, "decay": 2}});
        let mut other = AdamW::new(at(&[0.; 4]), AdamWSettings::default());
        let error = other.resume(&path, &run).unwrap_err().to_string();
        assert!(error.contains("`w`"), "{error}");
        std::fs::write(&path, b"noise").unwrap();
        assert!(optimiser.resume(&path, &run).is_err());
    }

    #[test]
    fn missing_and_nan_gradients_are_named_without_effect() {
        let mut optimiser = quadratic(AdamWSettings::default());
        let error = optimiser.step(&[], 0.1).unwrap_err().to_string();
        assert!(error.contains("`w`"), "{error}");
        let error = optimiser.step(&[vec![0., f32::NAN, 0.]], 0.1).unwrap_err();
        assert!(error.to_string().contains("`w`"), "{error}");
        assert_eq!(
            (optimiser.steps_taken(), now(&optimiser)),
            (0, vec![3., -2., 0.5])
        );
    }
}
