//! Initial weights of a network.

use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
};

use candle_core::{DType, Device, Tensor};
use wm_model::{
    Compute, Kernels, Weights,
    transition::{Initialisation, Parameter},
};
use wm_zoo::{Loader, Supply};

use crate::optimiser::Variables;

/// The weights of a network at the start of its training, as variables.
///
/// Matrices and kernels are Xavier-uniform, embeddings and queries normal with standard deviation 0.02, scales of norms
/// and of whole blocks (LayerScale) one, everything else zero; each from a generator of its own, so that it depends on the seed and the name alone. In
/// fine-tuning, tensors of the same name and shape are taken from another model.
#[derive(Debug)]
pub struct FreshWeights {
    seed: u64,
    device: Device,
    dtype: DType,
    old: BTreeMap<String, Tensor>,
    /// Names taken from `old`.
    taken: RefCell<BTreeSet<String>>,
    variables: RefCell<Variables>,
}

impl FreshWeights {
    /// Fresh weights of this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self::tuning(seed, BTreeMap::new())
    }

    /// Takes matching tensors from another model.
    #[must_use]
    pub fn tuning(seed: u64, old: BTreeMap<String, Tensor>) -> Self {
        Self {
            seed,
            device: Device::Cpu,
            dtype: DType::F32,
            old,
            taken: RefCell::default(),
            variables: RefCell::default(),
        }
    }

    /// The same, but for what `weights` hold.
    ///
    /// # Errors
    /// If they cannot be read.
    pub fn tuning_weights(seed: u64, weights: &Weights) -> wm_model::Result<Self> {
        let tensors = weights.names().into_iter().map(|name| {
            // The name comes from the file; `tensor` reports a wrong shape.
            let shape = weights.shape(&name).unwrap_or_default().to_vec();
            let tensor = weights.tensor(&name, &shape)?;
            Ok((name, tensor))
        });
        Ok(Self::tuning(
            seed,
            tensors.collect::<wm_model::Result<_>>()?,
        ))
    }

    /// The same, on the device and in the number format of `compute`.
    ///
    /// # Errors
    /// If the device cannot be opened.
    pub fn on(self, compute: &Compute) -> wm_model::Result<Self> {
        Ok(Self {
            device: compute.device()?.clone(),
            dtype: compute.dtype(),
            ..self
        })
    }

    /// Adds rows with their usual initial values to the old tensor of a table, if there is one with fewer than `rows`.
    ///
    /// # Errors
    /// If they cannot be made.
    pub fn add_rows(&mut self, name: &str, rows: usize) -> candle_core::Result<()> {
        let Some(old) = self.old.get(name) else {
            return Ok(());
        };
        let (count, columns) = old.dims2()?;
        if count < rows {
            let new = self.usual(name, &[rows, columns])?;
            let new = new.narrow(0, count, rows - count)?;
            let table = Tensor::cat(&[old, &new.to_dtype(old.dtype())?], 0)?;
            self.old.insert(name.to_owned(), table);
        }
        Ok(())
    }

    /// The usual initial values of a parameter.
    ///
    /// # Errors
    /// If they cannot be made.
    pub fn usual(&self, name: &str, shape: &[usize]) -> candle_core::Result<Tensor> {
        if is_scale(name, shape) {
            return Tensor::ones(shape, DType::F32, &Device::Cpu);
        }
        let parameter = Parameter {
            name: name.to_owned(),
            shape: shape.to_vec(),
            initialisation: initialisation(name, shape),
        };
        parameter
            .initial(self.seed)
            .map_err(candle_core::Error::wrap)
    }

    /// Number format of the variables.
    #[must_use]
    pub fn dtype(&self) -> DType {
        self.dtype
    }

    /// The old tensor of a parameter, if of equal shape.
    pub fn take(&self, name: &str, shape: &[usize]) -> Option<&Tensor> {
        let old = self.old.get(name).filter(|old| old.dims() == shape)?;
        self.taken.borrow_mut().insert(name.to_owned());
        Some(old)
    }

    /// A variable that starts from the old tensor, or from `initial`.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn variable(
        &self,
        name: &str,
        shape: &[usize],
        initial: impl FnOnce() -> candle_core::Result<Tensor>,
    ) -> candle_core::Result<Tensor> {
        let initial = match self.take(name, shape) {
            Some(old) => old.clone(),
            None => initial()?,
        };
        let initial = initial.to_device(&self.device)?.to_dtype(self.dtype)?;
        self.variables.borrow_mut().add(name, &initial)
    }

    /// Supplies the weights to a network, with gradients.
    pub fn loader(&self) -> Loader<'_> {
        Loader::supplied(self, Kernels::Candle)
    }

    /// All supplied variables, and the names of those taken from another model.
    #[must_use]
    pub fn into_variables(self) -> (Variables, BTreeSet<String>) {
        let taken = self.taken.into_inner();
        let all = self.variables.into_inner();
        if !self.old.is_empty() {
            let anew = all.names().filter(|name| !taken.contains(*name));
            let anew: Vec<&str> = anew.collect();
            println!(
                "takes {} of {} tensors from the other model{}",
                taken.len(),
                taken.len() + anew.len(),
                if anew.is_empty() {
                    String::new()
                } else {
                    format!("; anew: {}", anew.join(", "))
                }
            );
        }
        (all, taken)
    }
}

impl Supply for FreshWeights {
    fn supply(&self, name: &str, shape: &[usize]) -> wm_zoo::Result<Tensor> {
        if let Some(tensor) = self.variables.borrow().get(name) {
            return Ok(tensor);
        }
        Ok(self.variable(name, shape, || self.usual(name, shape))?)
    }

    fn device(&self) -> Device {
        self.device.clone()
    }
}

fn is_scale(name: &str, shape: &[usize]) -> bool {
    shape.len() == 1 && (name.ends_with("weight") || name.ends_with("lambda1"))
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
