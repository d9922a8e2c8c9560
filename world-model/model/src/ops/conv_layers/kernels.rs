//! Networks on kernels of the CPU.

use std::cell::RefCell;

use super::{Conv, ConvLayers, GroupNorm};
use crate::Result;
use crate::ops::{Activation, GridSize, group_norm};

thread_local! {
    /// Memory of activations that were dropped. It stays until the thread ends: large memory that goes back to the
    /// system is cleared anew for every picture.
    static FREE: RefCell<Vec<Vec<f32>>> = RefCell::default();
}

/// The kernels of the CPU. Activations that are dropped make room for later ones of their thread.
pub(crate) struct ConvKernels;

/// Activations (image, row, column, channel).
pub(crate) struct Activations {
    pub(crate) values: Vec<f32>,
    pub(crate) grid: GridSize,
}

impl Drop for Activations {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.values);
        if values.capacity() > 0 {
            // A thread that ends keeps none.
            let _ = FREE.try_with(|free| free.borrow_mut().push(values));
        }
    }
}

impl ConvLayers for ConvKernels {
    type Value = Activations;

    fn conv(
        &mut self,
        conv: &Conv,
        x: &Activations,
        residual: Option<&Activations>,
    ) -> Result<Activations> {
        let mut output = FREE.with_borrow_mut(Vec::pop).unwrap_or_default();
        let residual = residual.map(|residual| residual.values.as_slice());
        let grid = conv.run(&x.values, x.grid, residual, &mut output)?;
        let values = output;
        Ok(Activations { values, grid })
    }

    fn group_norm_relu(&mut self, norm: &GroupNorm, mut x: Activations) -> Result<Activations> {
        let (scale, shift) = &norm.affine;
        group_norm(
            &mut x.values,
            x.grid.height * x.grid.width,
            norm.groups,
            (scale, shift),
            norm.eps,
            Activation::Relu,
        );
        Ok(x)
    }
}
