//! Parameters and operations of a network, counted as it is built.

use wm_model::Kernels;

use crate::loader::Requested;
use crate::{Loader, Result};

/// Parameters and operations of a part of a system.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Number of trained values.
    pub parameters: usize,
    /// Operations for one frame.
    pub operations: usize,
}

impl Cost {
    /// Parameters in millions.
    pub(crate) fn millions(self) -> f64 {
        self.parameters as f64 / 1e6
    }

    /// Operations for one frame in thousands of millions.
    pub(crate) fn gflops(self) -> f64 {
        self.operations as f64 / 1e9
    }
}

/// Builds a model without weights and adds up what it asked for: `operations` of every tensor.
pub(crate) fn count<M>(
    load: impl FnOnce(&Loader<'_>) -> Result<M>,
    operations: impl Fn(&Requested) -> usize,
) -> Result<Cost> {
    let loader = Loader::skeleton(Kernels::Candle);
    load(&loader)?;
    Ok(Cost {
        parameters: loader.parameters(),
        operations: loader.requested().iter().map(operations).sum(),
    })
}

/// Operations of a layer with this weight at `places` places; vectors (biases, norms, scales) cost nothing.
pub(crate) fn applied(weight: &Requested, places: usize) -> usize {
    match weight.shape.len() {
        0 | 1 => 0,
        _ => 2 * weight.count() * places,
    }
}

/// Operations of attention's two products, of `queries` queries with `keys` keys each.
pub(crate) fn attended(queries: usize, keys: usize, width: usize) -> usize {
    2 * 2 * queries * keys * width
}
