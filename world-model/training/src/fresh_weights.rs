//! The weights that the training of a network starts from.

use std::cell::RefCell;

use candle_core::Tensor;
use wm_model::transition::{Initialisation, Parameter};
use wm_zoo::{Engine, Loader, Supply};

use crate::optimiser::Variables;

/// The weights of a network at the start of its training, as variables.
///
/// Matrices and kernels are Xavier-uniform, embeddings and queries normal with standard deviation 0.02, scales of norms
/// one, everything else zero; each from a generator of its own, so that it depends on the seed and the name alone.
#[derive(Debug)]
pub struct FreshWeights {
    seed: u64,
    variables: RefCell<Variables>,
}

impl FreshWeights {
    /// Of this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            variables: RefCell::default(),
        }
    }

    /// Gives the weights to a network, by operations that propagate gradients.
    pub fn loader(&self) -> Loader<'_> {
        Loader::supplied(self, Engine::Candle)
    }

    /// All that was given.
    #[must_use]
    pub fn into_variables(self) -> Variables {
        self.variables.into_inner()
    }
}

impl Supply for FreshWeights {
    fn supply(&self, name: &str, shape: &[usize]) -> wm_zoo::Result<Tensor> {
        if let Some(tensor) = self.variables.borrow().get(name) {
            return Ok(tensor);
        }
        let initialisation = initialisation(name, shape);
        let parameter = Parameter {
            name: name.to_owned(),
            shape: shape.to_vec(),
            initialisation,
        };
        let initial = match is_scale(name, shape) {
            true => Tensor::ones(shape, candle_core::DType::F32, &candle_core::Device::Cpu)?,
            false => parameter.initial(self.seed)?,
        };
        Ok(self.variables.borrow_mut().add(name, &initial)?)
    }
}

fn is_scale(name: &str, shape: &[usize]) -> bool {
    shape.len() == 1 && name.ends_with("weight")
}

fn initialisation(name: &str, shape: &[usize]) -> Initialisation {
    if !name.ends_with("weight") && shape.len() > 1 {
        Initialisation::Normal(0.02)
    } else if shape.len() > 1 {
        Initialisation::Xavier
    } else {
        Initialisation::Zero
    }
}
