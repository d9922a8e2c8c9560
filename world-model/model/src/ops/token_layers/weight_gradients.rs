//! Gradients by weights that are no operands of candle's operations.

use std::{
    collections::{HashMap, hash_map::Entry},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use candle_core::{DType, Result, Tensor, TensorId, backprop::GradStore};

/// Gradients by weights that are no operands of candle's operations; see
/// [`Transition::collecting`](crate::transition::Transition::collecting).
#[derive(Clone, Debug, Default)]
pub struct WeightGradients(Arc<Mutex<HashMap<TensorId, Vec<f32>>>>);

impl WeightGradients {
    /// The gradient by `weight`, with what candle's own backward pass left in `store`; `None` if neither has one. It is
    /// forgotten here.
    ///
    /// # Errors
    /// If that of `store` cannot be read.
    pub fn take(&self, weight: &Tensor, store: &GradStore) -> Result<Option<Vec<f32>>> {
        let collected = self.lock().remove(&weight.id());
        let Some(own) = store.get(weight) else {
            return Ok(collected);
        };
        let mut sum = own.flatten_all()?.to_dtype(DType::F32)?.to_vec1()?;
        add(&mut sum, &collected.unwrap_or_default());
        Ok(Some(sum))
    }

    /// Adds one of them.
    pub(super) fn add(&self, weight: &Tensor, gradient: Vec<f32>) {
        match self.lock().entry(weight.id()) {
            Entry::Vacant(entry) => {
                entry.insert(gradient);
            }
            Entry::Occupied(mut sum) => add(sum.get_mut(), &gradient),
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<TensorId, Vec<f32>>> {
        // Whole entries are consistent whoever panicked.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) fn add(sum: &mut [f32], values: &[f32]) {
    for (sum, value) in sum.iter_mut().zip(values) {
        *sum += value;
    }
}
