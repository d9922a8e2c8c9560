//! Numbers with a shape.

/// Numbers with a shape, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    data: Vec<f32>,
}

impl Tensor {
    /// `data` in `shape`; `None` if the numbers of elements differ.
    ///
    /// ```
    /// use wm_evaluation::onnx::Tensor;
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

    /// The elements, moved.
    pub fn into_data(self) -> Vec<f32> {
        self.data
    }

    /// Entries along the first axis; none without axes or elements.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f32]> {
        // A tensor without axes is one row.
        let count = self.shape.first().copied().unwrap_or(0).max(1);
        self.data.chunks_exact((self.data.len() / count).max(1))
    }
}
