//! PyTorch's training steps, from ../fixtures/steps.py.

use std::collections::BTreeMap;

use candle_core::{Device, Tensor};
use serde::de::DeserializeOwned;
use wm_model::Weights;

use crate::{
    optimiser::{ParameterValues, Variables},
    workers::BatchLoss,
};

/// Largest relative error of losses, gradients and weights (norm of the difference over norm).
pub(crate) const TOLERANCE: f64 = 1e-4;

/// A file of ../fixtures/steps.
pub(crate) struct Fixture {
    name: String,
    case: serde_json::Value,
    tensors: Weights,
}

impl Fixture {
    pub(crate) fn open(name: &str) -> Self {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/steps");
        let tensors = Weights::open(format!("{folder}/{name}.safetensors")).unwrap();
        Self {
            name: name.into(),
            case: tensors.json("case").unwrap(),
            tensors,
        }
    }

    /// An entry of the case's description.
    pub(crate) fn of<T: DeserializeOwned>(&self, key: &str) -> T {
        serde_json::from_value(self.case[key].clone()).unwrap()
    }

    /// Values of a tensor.
    pub(crate) fn values(&self, name: &str) -> Vec<f32> {
        let shape = self.tensors.shape(name).unwrap_or_else(|| panic!("{name}"));
        self.tensors.values(name, shape).unwrap()
    }

    /// Names of the tensors below `prefix`, without the prefix.
    pub(crate) fn names(&self, prefix: &str) -> Vec<String> {
        let names = self.tensors.names().into_iter();
        let below = names.filter_map(|name| name.strip_prefix(prefix).map(str::to_owned));
        below.collect()
    }

    /// Checks the loss and its gradient, by each of `variables` and for all together; returns the gradient.
    pub(crate) fn check(
        &self,
        found: impl Into<BatchLoss>,
        variables: &Variables,
    ) -> Vec<Vec<f32>> {
        let BatchLoss {
            loss, gradients, ..
        } = found.into();
        let store = loss.backward().unwrap();
        let gradients = variables.gradients(&store, &gradients).unwrap();
        let parameters = variables.parameters(|_| 0).unwrap();
        let names: Vec<String> = parameters.into_iter().map(|p| p.name).collect();
        assert_eq!(names, self.names("gradient/"), "{}", self.name);
        let mut worst = self.check_one("loss", &[loss.to_scalar().unwrap()]);
        for (name, found) in names.iter().zip(&gradients) {
            worst = worst.max(self.check_one(&format!("gradient/{name}"), found));
        }
        let expected = names
            .iter()
            .map(|name| self.values(&format!("gradient/{name}")));
        let whole = error(&gradients.concat(), &expected.collect::<Vec<_>>().concat());
        println!(
            "{}: loss and gradients to {worst:.1e}, the whole gradient to {whole:.1e}",
            self.name
        );
        assert!(whole < TOLERANCE, "{}: {whole}", self.name);
        gradients
    }

    /// Checks a tensor; returns the relative error.
    pub(crate) fn check_one(&self, name: &str, found: &[f32]) -> f64 {
        let error = error(found, &self.values(name));
        assert!(error < TOLERANCE, "{}: {name}: {error:.2e}", self.name);
        error
    }
}

/// Norm of the difference over the norm of the expectation.
fn error(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let both = found.iter().zip(expected);
    let difference = norm(&mut both.map(|(x, y)| f64::from(*x) - f64::from(*y)));
    difference / norm(&mut expected.iter().map(|x| f64::from(*x)))
}

/// Numbers from -scale to scale by the formula of steps.py: a hash (murmur3's last step) of the name's hash (FNV-1a) and
/// the index.
pub(crate) fn values(name: &str, count: usize, scale: f64) -> Vec<f32> {
    let seed = name.bytes().fold(2_166_136_261_u32, |hash, byte| {
        (hash ^ u32::from(byte)).wrapping_mul(16_777_619)
    });
    let number = |place: u32| {
        let mut x = seed.wrapping_add(place.wrapping_mul(0x9E37_79B9));
        x = (x ^ (x >> 16)).wrapping_mul(0x85EB_CA6B);
        x = (x ^ (x >> 13)).wrapping_mul(0xC2B2_AE35);
        x ^= x >> 16;
        ((f64::from(x >> 8) / f64::from(1 << 23) - 1.0) * scale) as f32
    };
    (0..count as u32).map(number).collect()
}

/// [`values`] as a tensor.
pub(crate) fn tensor(name: &str, shape: &[usize], scale: f64) -> Tensor {
    let values = values(name, shape.iter().product(), scale);
    Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
}

/// Gives `variables` the values of steps.py's parameters.
pub(crate) fn fill(variables: &Variables) {
    let parameters = variables.parameters(|_| 0).unwrap();
    let weights: BTreeMap<_, _> = parameters
        .iter()
        .map(|parameter| {
            let (name, shape) = (&*parameter.name, &*parameter.shape);
            (name, (shape, weight(name, shape)))
        })
        .collect();
    let trained = weights
        .iter()
        .map(|(name, (shape, values))| ParameterValues {
            name,
            shape,
            values,
        });
    variables.assign(trained).unwrap();
}

fn weight(name: &str, shape: &[usize]) -> Vec<f32> {
    let count = shape.iter().product();
    match (shape.len(), name.ends_with("weight")) {
        (1, true) => {
            let own = values(name, count, 0.2);
            own.iter().map(|x| (1.0 + f64::from(*x)) as f32).collect()
        }
        (1, false) => values(name, count, 0.2),
        (_, false) => values(name, count, 0.5),
        (_, true) => {
            let fan_in: usize = shape.iter().skip(1).product();
            values(name, count, (3.0 / fan_in as f64).sqrt())
        }
    }
}
