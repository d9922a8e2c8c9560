//! Number formats of weights.

use std::fmt;
use std::str::FromStr;

use candle_core::DType;
use serde::{Deserialize, Serialize};

/// Number format of weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NumberFormat {
    /// 32-bit floats.
    #[default]
    F32,
    /// bfloat16, the upper half of a 32-bit float: half the memory, which bounds the speed of large models.
    ///
    /// If the processor multiplies bf16, activations are rounded to bf16 before they are multiplied, as in PyTorch,
    /// which is about twice as fast as f32. Elsewhere they stay f32. Sums are f32 in both.
    Bf16,
    /// 8-bit integers with a scale for every output, for the matrices of the CPU's kernels: a quarter of the memory.
    ///
    /// The inputs of a matrix are rounded to 8 bits as well, with a scale for every row, and the sums are exact: every
    /// processor gives the same bits. Sensitive matrices, convolutions and attention are as in [`Self::Bf16`]; tensors are
    /// not rounded.
    Int8,
}

impl NumberFormat {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::F32, Self::Bf16, Self::Int8];

    /// The format of tensors.
    pub fn dtype(self) -> DType {
        match self {
            Self::F32 | Self::Int8 => DType::F32,
            Self::Bf16 => DType::BF16,
        }
    }

    /// The format of matrices for which 8 bits are too few, if the others are in this one: those whose errors shift a
    /// whole output, and the first and last matrices of a model.
    pub fn sensitive(self) -> Self {
        match self {
            Self::F32 => Self::F32,
            Self::Bf16 | Self::Int8 => Self::Bf16,
        }
    }

    /// Its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
            Self::Int8 => "int8",
        }
    }
}

impl fmt::Display for NumberFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for NumberFormat {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|known| known.name() == name);
        found.ok_or_else(|| {
            format!(
                "`{name}`, expected {}",
                Self::ALL.map(Self::name).join(", ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_files() {
        for format in NumberFormat::ALL {
            assert_eq!(format.name().parse(), Ok(format));
            let json = serde_json::to_string(&format).unwrap();
            assert_eq!(json, format!("\"{format}\""));
        }
        let error = "int4".parse::<NumberFormat>().unwrap_err();
        assert_eq!(error, "`int4`, expected f32, bf16, int8");
    }
}
