//! y = x W^T + b, with its gradient, straight on `gemm`.
//!
//! Compared with a matmul and a broadcast add this saves a pass over y, and in the backward pass
//! the transposed copies.

use candle_core::{CpuStorage, CustomOp2, CustomOp3, Layout, Result, Shape, Tensor};
use gemm::Parallelism;

use super::host::{host, slice};
use super::vectorised::vectorised;
use crate::Kernels;

/// `x` (.., in) times the transpose of `weight` (out, in) plus `bias` (out): (.., out).
///
/// The kernel takes f32. The plain form takes any weight, multiplies in its number format, and gives that of `x`.
///
/// # Errors
/// If the shapes do not fit.
pub fn linear(
    kernels: Kernels,
    x: &Tensor,
    weight: &Tensor,
    bias: Option<&Tensor>,
) -> Result<Tensor> {
    if !kernels.takes_kernel(x) {
        return Linear::plain(x, weight, bias);
    }
    let x = x.contiguous()?;
    match bias {
        Some(bias) => x.apply_op3(weight, bias, Linear),
        None => x.apply_op2(weight, Linear),
    }
}

struct Linear;

impl Linear {
    /// Shape of the result, for shapes of the input and of the weight.
    fn shape(x: &Shape, weight: &Shape) -> Result<Shape> {
        let (n, k) = weight.dims2()?;
        let mut dims = x.dims().to_vec();
        match dims.last_mut() {
            Some(last) if *last == k => *last = n,
            _ => {
                candle_core::bail!("linear: input of shape {x:?} for a weight of shape {weight:?}")
            }
        }
        Ok(dims.into())
    }

    fn plain(x: &Tensor, weight: &Tensor, bias: Option<&Tensor>) -> Result<Tensor> {
        let shape = Self::shape(x.shape(), weight.shape())?;
        // As one product of two matrices: for a batch of them the weight would be copied for each.
        let rows = x.reshape(((), weight.dim(1)?))?;
        let y = rows.to_dtype(weight.dtype())?.matmul(&weight.t()?)?;
        let y = y.to_dtype(x.dtype())?;
        let y = match bias {
            Some(bias) => y.broadcast_add(&bias.to_dtype(x.dtype())?)?,
            None => y,
        };
        y.reshape(shape)
    }

    fn forward(
        x: (&CpuStorage, &Layout),
        weight: (&CpuStorage, &Layout),
        bias: Option<&[f32]>,
    ) -> Result<(CpuStorage, Shape)> {
        let (n, k) = weight.1.shape().dims2()?;
        let shape = Self::shape(x.1.shape(), weight.1.shape())?;
        let (x, weight) = (slice(x.0, x.1)?, slice(weight.0, weight.1)?);
        let mut y = vec![0.0; x.len() / k.max(1) * n];
        forward(x, (n, k), weight, bias, &mut y)?;
        Ok((CpuStorage::F32(y), shape))
    }

    fn backward(
        x: &Tensor,
        weight: &Tensor,
        grad: &Tensor,
        with_bias: bool,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let (n, k) = weight.dims2()?;
        let grad = grad.contiguous()?;
        let g = host(&grad);
        let g = g.values()?;
        let grad_x = if x.track_op() {
            let weight = host(weight);
            let mut out = vec![0.0; x.elem_count()];
            input_gradient(g, (n, k), weight.values()?, &mut out)?;
            Some(Tensor::from_vec(out, x.shape(), x.device())?)
        } else {
            None
        };
        let grad_weight = if weight.track_op() {
            let input = host(x);
            let mut out = vec![0.0; n * k];
            weight_gradient(g, (n, k), input.values()?, &mut out)?;
            Some(Tensor::from_vec(out, (n, k), x.device())?)
        } else {
            None
        };
        let grad_bias = if with_bias {
            let mut sums = vec![0.0; n];
            sum_rows(g, &mut sums);
            Some(Tensor::from_vec(sums, n, x.device())?)
        } else {
            None
        };
        Ok((grad_x, grad_weight, grad_bias))
    }
}

/// `y` (m, n) of `x` (m, k), for a weight (n, k) and a bias (n).
///
/// # Errors
/// If a slice has another length.
pub(crate) fn forward(
    x: &[f32],
    (n, k): (usize, usize),
    weight: &[f32],
    bias: Option<&[f32]>,
    y: &mut [f32],
) -> Result<()> {
    match bias {
        Some(bias) if bias.len() == n => y
            .chunks_exact_mut(n.max(1))
            .for_each(|row| row.copy_from_slice(bias)),
        Some(bias) => candle_core::bail!("linear: bias of {} values, {n} needed", bias.len()),
        None => {}
    }
    let sizes = (x.len() / k.max(1), k, n);
    let (x, weight) = (Matrix::rows(x, k), Matrix::columns(weight, k));
    multiply(sizes, x, weight, y, bias.is_some())
}

/// The gradient `out` (m, k) by x, of the gradient `g` (m, n) by y.
///
/// # Errors
/// If a slice has another length.
pub(crate) fn input_gradient(
    g: &[f32],
    (n, k): (usize, usize),
    weight: &[f32],
    out: &mut [f32],
) -> Result<()> {
    let sizes = (g.len() / n.max(1), n, k);
    multiply(
        sizes,
        Matrix::rows(g, n),
        Matrix::rows(weight, k),
        out,
        false,
    )
}

/// The gradient `out` (n, k) by the weight, of the gradient `g` (m, n) by y for inputs `x` (m, k).
///
/// # Errors
/// If a slice has another length.
pub(crate) fn weight_gradient(
    g: &[f32],
    (n, k): (usize, usize),
    x: &[f32],
    out: &mut [f32],
) -> Result<()> {
    let sizes = (n, g.len() / n.max(1), k);
    multiply(sizes, Matrix::columns(g, n), Matrix::rows(x, k), out, false)
}

impl CustomOp2 for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        Self::forward((s1, l1), (s2, l2), None)
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (x, weight, _) = Self::backward(x, weight, grad, false)?;
        Ok((x, weight))
    }
}

impl CustomOp3 for Linear {
    fn name(&self) -> &'static str {
        "linear with bias"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        Self::forward((s1, l1), (s2, l2), Some(slice(s3, l3)?))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weight: &Tensor,
        _bias: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        Self::backward(x, weight, grad, true)
    }
}

vectorised! {
    /// Adds `bias` to every row of `values`.
    pub(crate) fn add_to_rows(values: &mut [f32], bias: &[f32]) {
        for row in values.chunks_exact_mut(bias.len()) {
            for (value, bias) in row.iter_mut().zip(bias) {
                *value += bias;
            }
        }
    }
}

vectorised! {
    /// Multiplies the columns of `values` by `scale`, and adds the front of `residual`, of as many rows.
    fn scale_and_add(values: &mut [f32], scale: &[f32], residual: &[f32]) {
        let rows = values.chunks_exact_mut(scale.len()).zip(residual.chunks_exact(scale.len()));
        for (row, residual) in rows {
            for ((value, scale), residual) in row.iter_mut().zip(scale).zip(residual) {
                *value = value.mul_add(*scale, *residual);
            }
        }
    }
}

/// Multiplies the columns of `rows` (rows, `scale`) by `scale`, and adds the front of `residual`.
pub fn scale_and_add_rows(rows: &mut [f32], scale: &[f32], residual: &[f32]) {
    if !scale.is_empty() {
        scale_and_add(rows, scale, residual);
    }
}

vectorised! {
    /// Adds every row of `values` to `sums`.
    pub(crate) fn sum_rows(values: &[f32], sums: &mut [f32]) {
        for row in values.chunks_exact(sums.len()) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += value;
            }
        }
    }
}

/// A matrix in a slice: element (row, column) lies at row * row_stride + column * column_stride.
#[derive(Clone, Copy)]
struct Matrix<'a> {
    values: &'a [f32],
    row_stride: usize,
    column_stride: usize,
}

impl<'a> Matrix<'a> {
    /// A matrix whose rows of `width` values follow each other.
    fn rows(values: &'a [f32], width: usize) -> Self {
        Self {
            values,
            row_stride: width,
            column_stride: 1,
        }
    }

    /// A matrix whose columns of `height` values follow each other.
    fn columns(values: &'a [f32], height: usize) -> Self {
        Self {
            values,
            row_stride: 1,
            column_stride: height,
        }
    }

    fn holds(&self, rows: usize, columns: usize) -> bool {
        rows == 0
            || columns == 0
            || (rows - 1) * self.row_stride + (columns - 1) * self.column_stride < self.values.len()
    }
}

/// `out` (m, n) = [`out` +] a (m, k) b (k, n).
fn multiply(
    (m, k, n): (usize, usize, usize),
    a: Matrix<'_>,
    b: Matrix<'_>,
    out: &mut [f32],
    accumulate: bool,
) -> Result<()> {
    if !a.holds(m, k) || !b.holds(k, n) || out.len() != m * n {
        candle_core::bail!("linear: operands too small for a product of {m} x {k} x {n}");
    }
    let parallelism = match rayon::current_num_threads() {
        1 => Parallelism::None,
        threads => Parallelism::Rayon(threads),
    };
    // SAFETY: every element that the strides reach lies inside its slice (checked above), and
    // `out` is a unique borrow. Strides fit isize because slices are no longer than isize::MAX.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            out.as_mut_ptr(),
            1,
            n as isize,
            accumulate,
            a.values.as_ptr(),
            a.column_stride as isize,
            a.row_stride as isize,
            b.values.as_ptr(),
            b.column_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            parallelism,
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::comparison::{check_gradients, check_refused, check_same, random};
    use super::*;

    #[test]
    fn the_kernel_is_the_plain_form() {
        let (weight, bias) = (random(&[9, 16], 1), random(&[9], 2));
        for shape in [&[2, 3, 5, 16][..], &[7, 16]] {
            let x = random(shape, 3);
            for bias in [None, Some(&bias)] {
                check_same("linear", |kernels| linear(kernels, &x, &weight, bias));
            }
        }
        let x = random(&[3, 15], 4);
        check_refused("[3, 15] for a weight of shape [9, 16]", |kernels| {
            linear(kernels, &x, &weight, None)
        });
    }

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let inputs = [random(&[2, 3, 5], 1), random(&[4, 5], 2), random(&[4], 3)];
        check_gradients("linear with bias", &inputs, |kernels, inputs| {
            linear(kernels, &inputs[0], &inputs[1], Some(&inputs[2]))
        });
        check_gradients("linear", &inputs[..2], |kernels, inputs| {
            linear(kernels, &inputs[0], &inputs[1], None)
        });
    }
}
