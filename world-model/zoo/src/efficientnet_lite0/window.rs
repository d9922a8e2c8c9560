//! The places that a kernel sees.

/// How a kernel moves along rows and columns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    pub(super) kernel: usize,
    pub(super) stride: usize,
}

impl Window {
    /// Outputs along an axis, and the padding before and behind it: as few zeros as give
    /// ceil(inputs / stride) outputs, the odd one behind.
    pub(super) fn along(self, inputs: usize) -> (usize, usize, usize) {
        let outputs = inputs.div_ceil(self.stride);
        let covered = outputs.saturating_sub(1) * self.stride + self.kernel;
        let padding = covered.saturating_sub(inputs);
        (outputs, padding / 2, padding - padding / 2)
    }
}
