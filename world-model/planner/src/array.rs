//! A tensor as data.

use candle_core::{DType, Device, Tensor};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Most dimensions of an array: a batch of frames.
const MOST_DIMENSIONS: usize = 5;

/// A tensor of f32 as data, row-major.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawArray")]
pub struct Array {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// The serialised form, unchecked.
#[derive(Deserialize)]
struct RawArray {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// A count of values that does not match the shape.
#[derive(Debug, Error)]
#[error(
    "an array of shape {shape:?} has {found} values; expected at most {MOST_DIMENSIONS} dimensions and their product"
)]
struct ShapeError {
    shape: Vec<usize>,
    found: usize,
}

impl TryFrom<RawArray> for Array {
    type Error = ShapeError;

    fn try_from(RawArray { shape, values }: RawArray) -> Result<Self, ShapeError> {
        let product = |shape: &[usize]| {
            let mut sizes = shape.iter();
            sizes.try_fold(1_usize, |product, size| product.checked_mul(*size))
        };
        if shape.len() > MOST_DIMENSIONS || product(&shape) != Some(values.len()) {
            let found = values.len();
            return Err(ShapeError { shape, found });
        }
        Ok(Self { shape, values })
    }
}

impl Array {
    /// Copies the values of a tensor.
    ///
    /// # Errors
    /// If the tensor is not f32.
    pub fn of(tensor: &Tensor) -> wm_model::Result<Self> {
        Ok(Self {
            shape: tensor.dims().to_vec(),
            values: tensor.flatten_all()?.to_vec1()?,
        })
    }

    /// The tensor on the CPU.
    ///
    /// # Errors
    /// Those of candle; none is known, since the shape fits.
    pub fn tensor(&self) -> wm_model::Result<Tensor> {
        if self.values.is_empty() {
            let shape = self.shape.as_slice();
            return Ok(Tensor::zeros(shape, DType::F32, &Device::Cpu)?);
        }
        Ok(Tensor::from_slice(
            &self.values,
            self.shape.as_slice(),
            &Device::Cpu,
        )?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_must_match_the_number_of_values() {
        let parts = |shape: &[usize], values: usize| {
            let (shape, values) = (shape.to_vec(), vec![1.0; values]);
            Array::try_from(RawArray { shape, values })
        };
        for (shape, values) in [(&[2, 3][..], 6), (&[], 1), (&[0, 7], 0)] {
            let array = parts(shape, values).unwrap();
            let tensor = array.tensor().unwrap();
            assert_eq!(tensor.dims(), shape);
            assert_eq!(Array::of(&tensor).unwrap(), array);
        }
        let too_few = parts(&[2, 3], 5).unwrap_err().to_string();
        assert!(too_few.contains("[2, 3] has 5"), "{too_few}");
        assert!(parts(&[usize::MAX, 2], 6).is_err());
        assert!(parts(&[1; 6], 1).is_err());
    }
}
