//! Number formats of weights.

use std::fmt;
use std::str::FromStr;

use candle_core::DType;
use serde::{Deserialize, Serialize};
use wm_model::ops::PackedFormat;

/// Number format of weights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// 32-bit floats.
    #[default]
    F32,
    /// bfloat16: half the memory, sums are f32 all the same.
    Bf16,
    /// 8-bit whole numbers with a scale for every output, for the matrices of the CPU's kernels; what they are multiplied
    /// with is rounded to 8 bits too ([`PackedFormat::Int8`]). Sensitive matrices are bf16, and tensors not rounded.
    Int8,
}

impl Precision {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::F32, Self::Bf16, Self::Int8];

    /// The format of tensors.
    pub fn dtype(self) -> DType {
        match self {
            Self::F32 | Self::Int8 => DType::F32,
            Self::Bf16 => DType::BF16,
        }
    }

    /// What matrices are packed in for the kernels.
    pub fn packed(self) -> PackedFormat {
        match self {
            Self::F32 => PackedFormat::F32,
            Self::Bf16 => PackedFormat::Bf16,
            Self::Int8 => PackedFormat::Int8,
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

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Precision {
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
        for precision in Precision::ALL {
            assert_eq!(precision.name().parse(), Ok(precision));
            let json = serde_json::to_string(&precision).unwrap();
            assert_eq!(json, format!("\"{precision}\""));
        }
        let error = "int4".parse::<Precision>().unwrap_err();
        assert_eq!(error, "`int4`, expected f32, bf16, int8");
    }
}
