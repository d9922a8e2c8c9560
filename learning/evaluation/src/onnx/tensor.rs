//! Numbers with a shape.

/// Numbers with a shape, the last axis fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

impl Tensor {
    /// `data` in `shape`; `None` if the shape has another number of elements.
    ///
    /// ```
    /// use crate::onnx::Tensor;
    /// assert!(Tensor::new(vec![2, 3], vec![0.0; 6]).is_some());
    /// assert!(Tensor::new(vec![2, 3], vec![0.0; 5]).is_none());
    /// ```
    pub fn new(shape: Vec<usize>, data: Vec<f32>) -> Option<Self> {
        let len = shape
            .iter()
            .try_fold(1_usize, |product, &side| product.checked_mul(side))?;
        (len == data.len()).then_some(Self { shape, data })
    }

    /// Number of elements along each axis.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The elements.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// The elements, without a copy.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }

    /// The entries along the first axis, one slice each; none where there is no axis or no element.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        let count = self.shape.first().copied().unwrap_or(0).max(1);
        self.data.chunks_exact((self.data.len() / count).max(1))
    }
}
