//! Dynamics over some of the values of an action.

use candle_core::{Device, Tensor};

use super::Dynamics;

/// Dynamics whose actions are some values of another's: the others stay as they are.
pub struct Partial<'d> {
    whole: &'d mut dyn Dynamics,
    base: &'d [f32],
    searched: &'d [usize],
}

impl<'d> Partial<'d> {
    /// Dynamics over the values of `whole` with the indices `searched`; each of the others is that of `base` (A).
    pub fn new(whole: &'d mut dyn Dynamics, base: &'d [f32], searched: &'d [usize]) -> Self {
        Self {
            whole,
            base,
            searched,
        }
    }

    /// The whole action of some values of it.
    pub fn whole(&self, action: &[f32]) -> Vec<f32> {
        let mut whole = self.base.to_vec();
        for (index, value) in self.searched.iter().zip(action) {
            if let Some(place) = whole.get_mut(*index) {
                *place = *value;
            }
        }
        whole
    }
}

impl Dynamics for Partial<'_> {
    fn action_dim(&self) -> usize {
        self.searched.len()
    }

    fn rollout(&mut self, actions: &Tensor) -> crate::Result<Tensor> {
        let (count, steps, values) = actions.dims3()?;
        let flat = actions.flatten_all()?.to_vec1::<f32>()?;
        let whole: Vec<f32> = flat
            .chunks_exact(values.max(1))
            .flat_map(|action| self.whole(action))
            .collect();
        let shape = (count, steps, self.base.len());
        self.whole
            .rollout(&Tensor::from_vec(whole, shape, &Device::Cpu)?)
    }
}
