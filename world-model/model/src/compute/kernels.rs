//! Our kernels, or candle's operations.

use std::fmt;
use std::str::FromStr;

use candle_core::Tensor;

use crate::Error;

/// The kernels of a model's layers. Both kinds give the same numbers, to rounding, and both have gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernels {
    /// Candle's own operations: any device, the reference.
    Candle,
    /// Our kernels, for f32 tensors on the CPU, with weights of f32, bf16 or int8 that are packed once. A layer without
    /// a kernel takes candle's operations.
    #[default]
    Cpu,
}

impl Kernels {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Candle => "candle",
            Self::Cpu => "cpu",
        }
    }

    /// Whether our kernel computes `x`.
    pub(crate) fn takes_kernel(self, x: &Tensor) -> bool {
        self == Self::Cpu && x.device().is_cpu()
    }
}

impl fmt::Display for Kernels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kernels {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        [Self::Candle, Self::Cpu]
            .into_iter()
            .find(|kernels| kernels.name() == name)
            .ok_or_else(|| Error::config("engine", format!("`{name}`, expected candle or cpu")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for kernels in [Kernels::Candle, Kernels::Cpu] {
            assert_eq!(kernels.to_string().parse::<Kernels>().unwrap(), kernels);
        }
        let message = "gpu".parse::<Kernels>().unwrap_err().to_string();
        assert!(message.contains("`gpu`"), "{message}");
    }
}
