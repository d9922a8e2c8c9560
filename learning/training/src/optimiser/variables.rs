use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, Var, backprop::GradStore};
use rayon::prelude::*;
use wm_model::transition::WeightGradients;
use wm_zoo::Supply;

use super::{OptimiserError, Parameter, ParameterValues};

/// Trained tensors of a candle model, by name.
#[derive(Clone, Debug, Default)]
pub struct Variables(BTreeMap<String, Var>);

impl Variables {
    /// Adds a trained tensor that starts at `initial`.
    ///
    /// # Errors
    /// If it cannot be copied.
    pub fn add(&mut self, name: &str, initial: &Tensor) -> Result<Tensor> {
        let var = Var::from_tensor(initial)?;
        let tensor = var.as_tensor().clone();
        self.0.insert(name.to_owned(), var);
        Ok(tensor)
    }

    /// Names in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// The tensor of a name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<Tensor> {
        self.0.get(name).map(|var| var.as_tensor().clone())
    }

    /// Initial parameters of an optimiser; `group` gives the group of a name.
    ///
    /// # Errors
    /// If a value cannot be read.
    pub fn parameters(&self, group: impl Fn(&str) -> usize) -> Result<Vec<Parameter>> {
        let parameters = self.0.iter().map(|(name, var)| {
            Ok(Parameter {
                name: name.clone(),
                shape: var.dims().to_vec(),
                values: values(var)?,
                group: group(name),
            })
        });
        parameters.collect()
    }

    /// Values of all tensors, in the order of names.
    ///
    /// # Errors
    /// If a value cannot be read.
    pub fn values(&self) -> Result<Vec<Vec<f32>>> {
        self.0.values().map(|var| values(var)).collect()
    }

    /// Numbers of values, in the order of names.
    #[must_use]
    pub fn sizes(&self) -> Vec<usize> {
        self.0.values().map(|var| var.elem_count()).collect()
    }

    /// Assigns values in the order of names.
    ///
    /// # Errors
    /// If a size differs.
    pub fn assign_values(&self, values: &[Vec<f32>]) -> Result<()> {
        let trained = self.0.iter().zip(values).map(|((name, var), values)| {
            let shape = var.dims();
            ParameterValues {
                name,
                shape,
                values,
            }
        });
        self.assign(trained)
    }

    /// Assigns trained values; unknown names are skipped.
    ///
    /// # Errors
    /// If a shape differs.
    pub fn assign<'a>(&self, weights: impl Iterator<Item = ParameterValues<'a>>) -> Result<()> {
        let weights: Vec<_> = weights
            .filter_map(|trained| Some((self.0.get(trained.name)?, trained)))
            .collect();
        weights.into_par_iter().try_for_each(|(var, trained)| {
            let tensor = Tensor::from_slice(trained.values, trained.shape, &Device::Cpu)?;
            var.set(&tensor.to_device(var.device())?.to_dtype(var.dtype())?)
        })
    }

    /// Gradient of every variable, by name: the sum of those in `store` and in `collected`.
    ///
    /// # Errors
    /// If a variable has no gradient: some operation between it and the loss drops it.
    pub fn gradients(
        &self,
        store: &GradStore,
        collected: &WeightGradients,
    ) -> anyhow::Result<Vec<Vec<f32>>> {
        let gradients = self.0.iter().map(|(name, var)| {
            let gradient = collected.take(var, store)?;
            Ok(gradient.ok_or_else(|| OptimiserError::NoGradient(name.clone()))?)
        });
        gradients.collect()
    }
}

/// Loads networks from existing variables.
impl Supply for Variables {
    fn supply(&self, name: &str, shape: &[usize]) -> wm_zoo::Result<Tensor> {
        let tensor = self.get(name).filter(|tensor| tensor.dims() == shape);
        let missing = || wm_model::Error::MissingTensor {
            file: "the training's variables".to_owned(),
            name: name.to_owned(),
            expected: shape.to_vec(),
        };
        Ok(tensor.ok_or_else(missing)?)
    }

    fn device(&self) -> Device {
        let first = self.0.values().next();
        first.map_or(Device::Cpu, |var| var.device().clone())
    }
}

fn values(tensor: &Tensor) -> Result<Vec<f32>> {
    tensor.flatten_all()?.to_dtype(DType::F32)?.to_vec1()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_ordered_and_missing_ones_named() {
        let mut variables = Variables::default();
        let two = Tensor::new(&[2f32, 3.], &Device::Cpu).unwrap();
        let w = variables.add("w", &two).unwrap();
        let b = variables.add("b", &two).unwrap();
        let loss = (w.sqr().unwrap() + b).unwrap().sum_all().unwrap();
        let store = loss.backward().unwrap();
        let none = WeightGradients::default();
        assert_eq!(
            variables.gradients(&store, &none).unwrap(),
            [vec![1., 1.], vec![4., 6.]]
        );
        variables.add("idle", &two).unwrap();
        let error = variables.gradients(&store, &none).unwrap_err().to_string();
        assert!(error.contains("`idle`"), "{error}");
    }

    #[test]
    fn assigned_values_reach_the_model() {
        let mut variables = Variables::default();
        let zero = Tensor::zeros(2, DType::F32, &Device::Cpu).unwrap();
        let w = variables.add("w", &zero).unwrap();
        let told = ParameterValues {
            name: "w",
            shape: &[2],
            values: &[4., 5.],
        };
        variables.assign(std::iter::once(told)).unwrap();
        assert_eq!(w.to_vec1::<f32>().unwrap(), [4., 5.]);
    }
}
