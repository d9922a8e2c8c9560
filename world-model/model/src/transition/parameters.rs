//! Names, shapes and initial values of the parameters.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Tensor};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use sha2::{Digest, Sha256};

use super::TransitionConfig;
use super::linear_layer::Initialisation::{self, Xavier, Zero};
use super::linear_layer::{LinearLayer, LinearSource};
use super::network::Network;
use crate::ops::token_layers::Linear;
use crate::{Error, Result};

/// One parameter of the model.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name as in the published checkpoints.
    pub name: String,
    /// Shape; a Linear's weight is (out, in), the patch convolution's (out, C, p, p).
    pub shape: Vec<usize>,
    /// Values that training starts from.
    pub initialisation: Initialisation,
}

impl Parameter {
    /// Its initial values, from a generator of its own: they depend on the seed and the name only.
    ///
    /// # Errors
    /// If the tensor cannot be made.
    pub fn initial(&self, seed: u64) -> Result<Tensor> {
        let mut rng = self.generator(seed);
        let count = self.shape.iter().product();
        let values: Vec<f32> = match self.initialisation {
            Initialisation::Zero => vec![0.0; count],
            Initialisation::Xavier => {
                let bound = (6.0 / (self.fan_in() + self.fan_out()) as f64).sqrt();
                (0..count)
                    .map(|_| rng.random_range(-bound..bound) as f32)
                    .collect()
            }
            Initialisation::Normal(deviation) => (0..count)
                .map(|_| {
                    let z: f64 = StandardNormal.sample(&mut rng);
                    (z * deviation) as f32
                })
                .collect(),
        };
        Ok(Tensor::from_vec(
            values,
            self.shape.as_slice(),
            &Device::Cpu,
        )?)
    }

    /// Random values that leave no part of the model without effect.
    pub(super) fn sample(&self, seed: u64) -> Result<Tensor> {
        let deviation = match self.shape.len() {
            1 => 0.1,
            _ => 1.0 / (self.fan_in() as f64).sqrt(),
        };
        Self {
            initialisation: Initialisation::Normal(deviation),
            ..self.clone()
        }
        .initial(seed)
    }

    fn fan_in(&self) -> usize {
        self.shape.iter().skip(1).product()
    }

    fn fan_out(&self) -> usize {
        self.shape.first().copied().unwrap_or(1)
    }

    fn generator(&self, seed: u64) -> ChaCha8Rng {
        let mut hash = Sha256::new();
        hash.update(seed.to_le_bytes());
        hash.update(self.name.as_bytes());
        ChaCha8Rng::from_seed(hash.finalize().into())
    }
}

/// All parameters, in the order of the forward pass.
pub(super) fn all(config: &TransitionConfig) -> Vec<Parameter> {
    let (d, p) = (config.hidden, config.patch);
    let mut list = List::default();
    list.push("x_proj.weight", &[d, config.channels, p, p], Xavier);
    list.push("x_proj.bias", &[d], Zero);
    // A list refuses no layer.
    Network::new(config, &mut list).ok();
    list.0
}

#[derive(Default)]
struct List(Vec<Parameter>);

impl List {
    fn push(&mut self, name: &str, shape: &[usize], initialisation: Initialisation) {
        self.0.push(Parameter {
            name: name.to_owned(),
            shape: shape.to_vec(),
            initialisation,
        });
    }
}

impl LinearSource for List {
    type Linear = ();

    fn linear(&mut self, name: &str, layer: LinearLayer) -> Result<()> {
        let (outputs, inputs) = layer.shape;
        let weight = format!("{name}.weight");
        self.push(&weight, &[outputs, inputs], layer.initialisation);
        if layer.has_bias {
            self.push(&format!("{name}.bias"), &[outputs], Zero);
        }
        Ok(())
    }
}

/// The tensors of a model under construction.
pub(super) struct Tensors(BTreeMap<String, Tensor>);

impl Tensors {
    /// Asks `source` for every parameter; all have to be on one device and in one number format.
    pub(super) fn collect(
        config: &TransitionConfig,
        source: &mut dyn FnMut(&Parameter) -> Result<Tensor>,
    ) -> Result<Self> {
        let mut tensors = BTreeMap::new();
        let mut first: Option<(Device, DType)> = None;
        for parameter in all(config) {
            let tensor = source(&parameter)?;
            let (device, dtype) =
                first.get_or_insert_with(|| (tensor.device().clone(), tensor.dtype()));
            if !tensor.device().same_device(device) || tensor.dtype() != *dtype {
                let reason = format!(
                    "`{}` is {:?} on {:?}, expected {dtype:?} on {:?} as the parameters before it",
                    parameter.name,
                    tensor.dtype(),
                    tensor.device().location(),
                    device.location()
                );
                return Err(Error::config("parameters", reason));
            }
            if tensor.dims() != parameter.shape {
                return Err(Error::TensorShape {
                    file: "the source of the weights".into(),
                    name: parameter.name,
                    expected: parameter.shape,
                    found: tensor.dims().to_vec(),
                });
            }
            tensors.insert(parameter.name, tensor);
        }
        Ok(Self(tensors))
    }

    /// Those that were not handed out yet, by their names.
    pub(super) fn rest(&self) -> &BTreeMap<String, Tensor> {
        &self.0
    }

    /// Hands out a parameter.
    pub(super) fn take(&mut self, name: &str) -> Result<Tensor> {
        self.0.remove(name).ok_or_else(|| Error::MissingTensor {
            file: "the list of parameters".into(),
            name: name.to_owned(),
            expected: Vec::new(),
        })
    }
}

/// Tensors are in one number format, sensitive or not.
impl LinearSource for Tensors {
    type Linear = Linear;

    fn linear(&mut self, name: &str, layer: LinearLayer) -> Result<Linear> {
        let mut take = |end| self.take(&format!("{name}.{end}"));
        Ok(Linear {
            weight: take("weight")?,
            bias: layer.has_bias.then(|| take("bias")).transpose()?,
        })
    }
}
