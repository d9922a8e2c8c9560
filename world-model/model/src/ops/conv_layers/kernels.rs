//! Networks on kernels of the CPU.

use std::cell::RefCell;
use std::rc::Rc;

use super::{Conv, ConvLayers, GroupNorm};
use crate::Result;
use crate::ops::{Activation, GridSize, group_norm};

/// Memory of activations that were dropped.
type FreeBuffers = Rc<RefCell<Vec<Vec<f32>>>>;

/// The kernels of the CPU, and the memory of one run: activations that are dropped make room for later ones.
#[derive(Default)]
pub(crate) struct Kernels {
    free: FreeBuffers,
}

/// Activations (image, row, column, channel).
pub(crate) struct Activations {
    pub(crate) values: Vec<f32>,
    pub(crate) grid: GridSize,
    free: FreeBuffers,
}

impl Kernels {
    /// The input of a network.
    pub(crate) fn input(&self, values: Vec<f32>, grid: GridSize) -> Activations {
        let free = Rc::clone(&self.free);
        Activations { values, grid, free }
    }
}

impl Drop for Activations {
    fn drop(&mut self) {
        let values = std::mem::take(&mut self.values);
        self.free.borrow_mut().push(values);
    }
}

impl ConvLayers for Kernels {
    type Value = Activations;

    fn conv(
        &mut self,
        conv: &Conv,
        x: &Activations,
        residual: Option<&Activations>,
    ) -> Result<Activations> {
        let mut output = self.free.borrow_mut().pop().unwrap_or_default();
        let residual = residual.map(|residual| residual.values.as_slice());
        let grid = conv.run(&x.values, x.grid, residual, &mut output)?;
        Ok(self.input(output, grid))
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
