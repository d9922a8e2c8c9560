//! Doubling the size of pictures.

use candle_core::Tensor;

use crate::Result;

/// Repeats every place of `x` (N, H, W, C) twice in both directions: (N, 2 H, 2 W, C).
///
/// # Errors
/// If `x` has not four dimensions.
pub(crate) fn upsample_nearest_2x(x: &Tensor) -> Result<Tensor> {
    let (n, h, w, c) = x.dims4()?;
    Ok(x.reshape((n, h, 1, w, 1, c))?
        .broadcast_as((n, h, 2, w, 2, c))?
        .reshape((n, 2 * h, 2 * w, c))?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn every_place_is_there_four_times() {
        let x = Tensor::arange(0f32, 8.0, &Device::Cpu).unwrap();
        let x = x.reshape((1, 2, 2, 2)).unwrap();
        let y = upsample_nearest_2x(&x).unwrap();
        assert_eq!(y.dims(), [1, 4, 4, 2]);
        let rows = y.reshape((4, 8)).unwrap().to_vec2::<f32>().unwrap();
        assert_eq!(rows[0], [0., 1., 0., 1., 2., 3., 2., 3.]);
        assert_eq!(rows[1], rows[0]);
        assert_eq!(rows[3], [4., 5., 4., 5., 6., 7., 6., 7.]);
    }
}
