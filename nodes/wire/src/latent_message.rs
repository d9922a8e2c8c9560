//! Conversion of latents between messages and numbers.
//!
//! On the wire a latent is little-endian f32, f16 or bf16. In the nodes it is `Vec<f32>`, row-major, channels last. A
//! latent of another space, shape or length, or with a value that is not finite, is an error that names it, and never
//! reaches a model.

use half::{bf16, f16};
use thiserror::Error;
use wm_model::LatentSpace;
use wm_msgs::{
    std_msgs::Header,
    wm_msgs::{CameraState, Latent, LatentSpace as SpaceMessage},
};
use wm_ros::Qos;

/// The QoS of latents between nodes.
pub const LATENT_QOS: Qos = Qos::sensor_data();

/// The number type on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LatentDtype {
    /// IEEE 754 binary32.
    F32,
    /// IEEE 754 binary16: the default; halves the traffic with an error far below the model's.
    #[default]
    F16,
    /// bfloat16: the range of f32, 8 bits of precision.
    Bf16,
}

impl LatentDtype {
    /// Parses `f32`, `f16` or `bf16`.
    pub fn parse(name: &str) -> Option<Self> {
        match name {
            "f32" => Some(Self::F32),
            "f16" => Some(Self::F16),
            "bf16" => Some(Self::Bf16),
            _ => None,
        }
    }

    /// Bytes of one number.
    pub fn size(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F16 | Self::Bf16 => 2,
        }
    }

    fn from_wire(wire: u8) -> Result<Self, LatentError> {
        match wire {
            Latent::F32 => Ok(Self::F32),
            Latent::F16 => Ok(Self::F16),
            Latent::BF16 => Ok(Self::Bf16),
            other => Err(LatentError::Dtype(other)),
        }
    }

    fn to_wire(self) -> u8 {
        match self {
            Self::F32 => Latent::F32,
            Self::F16 => Latent::F16,
            Self::Bf16 => Latent::BF16,
        }
    }
}

/// Why a latent message is invalid, or cannot be made.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages explain variants and fields")]
pub enum LatentError {
    #[error(
        "latent of space \"{actual_name}\" ({actual_hash}); expected \"{expected_name}\" ({expected_hash})"
    )]
    Space {
        actual_name: String,
        actual_hash: String,
        expected_name: String,
        expected_hash: String,
    },
    #[error("latent of shape {actual:?}; expected {expected:?} (height, width, channels)")]
    Shape {
        actual: (u32, u32, u32),
        expected: (usize, usize, usize),
    },
    #[error("latent dtype is {0}; expected 0 (f32), 1 (f16) or 2 (bf16)")]
    Dtype(u8),
    /// The number of values or bytes does not match the shape.
    #[error("latent data has {actual} {unit}; its shape and dtype need {expected}")]
    Length {
        actual: usize,
        expected: usize,
        /// `bytes` or `values`.
        unit: &'static str,
    },
    /// A value is not a number, or infinite in the wire's dtype.
    #[error("value {index} of the latent is not finite")]
    NotFinite {
        /// In row-major order.
        index: usize,
    },
}

impl LatentError {
    /// The drop reason.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Space { .. } => "wrong_space",
            _ => "malformed_latent",
        }
    }
}

/// Encodes a latent: `values` of `space`, row-major, channels last, in `dtype`.
///
/// # Errors
/// [`LatentError::Length`]; [`LatentError::NotFinite`] if a value is not finite, or beyond the range of `dtype`.
pub fn encode_latent(
    values: &[f32],
    space: &LatentSpace,
    dtype: LatentDtype,
    header: Header,
) -> Result<Latent, LatentError> {
    if values.len() != space.elements() {
        return Err(LatentError::Length {
            actual: values.len(),
            expected: space.elements(),
            unit: "values",
        });
    }
    let mut data = Vec::with_capacity(values.len() * dtype.size());
    for (index, value) in values.iter().enumerate() {
        let is_finite = match dtype {
            LatentDtype::F32 => {
                data.extend(value.to_le_bytes());
                value.is_finite()
            }
            LatentDtype::F16 => {
                let half = f16::from_f32(*value);
                data.extend(half.to_le_bytes());
                half.is_finite()
            }
            LatentDtype::Bf16 => {
                let half = bf16::from_f32(*value);
                data.extend(half.to_le_bytes());
                half.is_finite()
            }
        };
        if !is_finite {
            return Err(LatentError::NotFinite { index });
        }
    }
    // a side beyond 32 bits fits no message and no space
    let side = |value: usize| u32::try_from(value).unwrap_or(u32::MAX);
    Ok(Latent {
        header,
        space: SpaceMessage {
            name: space.name.clone(),
            hash: space.hash.clone(),
        },
        height: side(space.height),
        width: side(space.width),
        channels: side(space.channels),
        dtype: dtype.to_wire(),
        epoch: 0,
        change: CameraState::NOT_MEASURED,
        frozen: false,
        data,
    })
}

/// The values of a latent of `space`, row-major, channels last.
///
/// # Errors
/// [`LatentError`] names the fault.
pub fn decode_latent(latent: &Latent, space: &LatentSpace) -> Result<Vec<f32>, LatentError> {
    if latent.space.name != space.name || latent.space.hash != space.hash {
        return Err(LatentError::Space {
            actual_name: latent.space.name.clone(),
            actual_hash: latent.space.hash.clone(),
            expected_name: space.name.clone(),
            expected_hash: space.hash.clone(),
        });
    }
    let actual = (latent.height, latent.width, latent.channels);
    let sides = [
        (latent.height, space.height),
        (latent.width, space.width),
        (latent.channels, space.channels),
    ];
    if sides
        .iter()
        .any(|(came, expected)| usize::try_from(*came).ok() != Some(*expected))
    {
        return Err(LatentError::Shape {
            actual,
            expected: space.shape(),
        });
    }
    let dtype = LatentDtype::from_wire(latent.dtype)?;
    let expected = space.elements() * dtype.size();
    if latent.data.len() != expected {
        return Err(LatentError::Length {
            actual: latent.data.len(),
            expected,
            unit: "bytes",
        });
    }
    let values: Vec<f32> = match dtype {
        LatentDtype::F32 => words(&latent.data).map(f32::from_le_bytes).collect(),
        LatentDtype::F16 => words(&latent.data)
            .map(|word| f16::from_le_bytes(word).to_f32())
            .collect(),
        LatentDtype::Bf16 => words(&latent.data)
            .map(|word| bf16::from_le_bytes(word).to_f32())
            .collect(),
    };
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(LatentError::NotFinite { index }),
        None => Ok(values),
    }
}

/// The data in words of N bytes. The length was checked before.
fn words<const N: usize>(data: &[u8]) -> impl Iterator<Item = [u8; N]> {
    data.chunks_exact(N).filter_map(|word| word.try_into().ok())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use proptest::prelude::*;

    use super::*;

    fn space() -> LatentSpace {
        LatentSpace {
            name: "test".into(),
            hash: "abc".into(),
            height: 2,
            width: 3,
            channels: 2,
        }
    }

    fn good(dtype: LatentDtype) -> Latent {
        encode_latent(&[0.5; 12], &space(), dtype, Header::default()).unwrap()
    }

    #[test]
    fn each_error_names_what_is_wrong() {
        let latent = good(LatentDtype::F16);
        let refused = |latent: Latent| decode_latent(&latent, &space()).unwrap_err();
        let other = SpaceMessage {
            name: "test".into(),
            hash: "def".into(),
        };
        assert!(
            refused(Latent {
                space: other,
                ..latent.clone()
            })
            .to_string()
            .contains("(def)")
        );
        assert!(
            refused(Latent {
                height: 3,
                width: 2,
                ..latent.clone()
            })
            .to_string()
            .contains("(3, 2, 2)")
        );
        assert_eq!(
            refused(Latent {
                dtype: 9,
                ..latent.clone()
            }),
            LatentError::Dtype(9)
        );
        let short = Latent {
            data: vec![0; 23],
            ..latent.clone()
        };
        assert_eq!(
            refused(short),
            LatentError::Length {
                actual: 23,
                expected: 24,
                unit: "bytes"
            }
        );
        let mut data = latent.data.clone();
        data.splice(4..6, f16::NAN.to_le_bytes());
        assert_eq!(
            refused(Latent { data, ..latent }),
            LatentError::NotFinite { index: 2 }
        );
    }

    #[test]
    fn values_beyond_the_dtype_are_refused() {
        let mut values = [0.0; 12];
        values[7] = 7e4;
        let encode = |dtype| encode_latent(&values, &space(), dtype, Header::default());
        assert_eq!(
            encode(LatentDtype::F16),
            Err(LatentError::NotFinite { index: 7 })
        );
        assert!(encode(LatentDtype::Bf16).is_ok() && encode(LatentDtype::F32).is_ok());
        let short = encode_latent(&values[..11], &space(), LatentDtype::F32, Header::default());
        assert_eq!(
            short,
            Err(LatentError::Length {
                actual: 11,
                expected: 12,
                unit: "values"
            })
        );
    }

    proptest! {
        #[test]
        fn values_round_trip(values in prop::collection::vec(-100.0_f32..100.0, 12)) {
            // largest relative rounding: none, 2^-11, 2^-8; and f16's smallest step near zero
            for (dtype, relative) in [
                (LatentDtype::F32, 0.0), (LatentDtype::F16, 1.0 / 2048.0), (LatentDtype::Bf16, 1.0 / 256.0),
            ] {
                let latent = encode_latent(&values, &space(), dtype, Header::default()).unwrap();
                let back = decode_latent(&latent, &space()).unwrap();
                for (value, back) in values.iter().zip(&back) {
                    let tolerance = value.abs() * relative + if dtype == LatentDtype::F16 { 3e-8 } else { 0.0 };
                    prop_assert!((value - back).abs() <= tolerance, "{value} {back} {dtype:?}");
                }
                // a second rounding changes nothing
                prop_assert_eq!(encode_latent(&back, &space(), dtype, Header::default()).unwrap(), latent);
            }
        }

        #[test]
        fn no_message_panics(height in 0_u32..4, width in 0_u32..4, channels in 0_u32..4, dtype in 0_u8..4,
                             data in prop::collection::vec(any::<u8>(), 0..60)) {
            let latent = Latent { height, width, channels, dtype, data, ..good(LatentDtype::F32) };
            if let Ok(values) = decode_latent(&latent, &space()) {
                prop_assert_eq!(values.len(), 12);
            }
        }
    }
}
