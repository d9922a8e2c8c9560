//! The Haar wavelet patches of Cosmos: an image as four half-sized ones, exactly reversible.
//!
//! Source: `docs/architecture.md#encoders`; upstream `Patcher` and `UnPatcher` of NVIDIA/Cosmos-Tokenizer, whose
//! filters 1/sqrt(2) twice and a factor 1/2 make the plain quarter used here.
//!
//! Of each 2x2 cell `a b / c d` come LL = (a+b+c+d)/4, LH = (a+b-c-d)/4, HL = (a-b+c-d)/4, HH = (a-b-c+d)/4.
//! The channels are all LL, then all LH, all HL, all HH. A second level treats all of those channels alike,
//! not LL only.

use candle_core::Tensor;

use super::seam::check_grid;
use crate::Result;

/// One level: (N, H, W, C) to (N, H / 2, W / 2, 4 C).
///
/// # Errors
/// If `x` has not four dimensions, or H or W is odd.
pub(crate) fn split(x: &Tensor) -> Result<Tensor> {
    // Without a dimension it fails, like any other than four.
    check_grid("Haar input", x, x.dims().last().copied().unwrap_or(0), 2)?;
    let (images, height, width, channels) = x.dims4()?;
    let cells = x.reshape((images, height / 2, 2, width / 2, 2, channels))?;
    let pixel = |row: usize, column: usize| -> Result<Tensor> {
        Ok(cells.narrow(2, row, 1)?.narrow(4, column, 1)?.reshape((
            images,
            height / 2,
            width / 2,
            channels,
        ))?)
    };
    let (top_sum, top_difference) = butterfly(&pixel(0, 0)?, &pixel(0, 1)?)?;
    let (bottom_sum, bottom_difference) = butterfly(&pixel(1, 0)?, &pixel(1, 1)?)?;
    let (ll, lh) = butterfly(&top_sum, &bottom_sum)?;
    let (hl, hh) = butterfly(&top_difference, &bottom_difference)?;
    Ok((Tensor::cat(&[ll, lh, hl, hh], 3)? * 0.25)?)
}

/// The inverse of [`split`]: (N, h, w, 4 C) to (N, 2 h, 2 w, C).
///
/// # Errors
/// If `x` has not four dimensions, or the channels are not a multiple of four.
pub(crate) fn join(x: &Tensor) -> Result<Tensor> {
    let (images, height, width, bands) = x.dims4()?;
    let channels = bands / 4;
    // Refuses a remainder of the division.
    check_grid("Haar bands", x, 4 * channels.max(1), 1)?;
    let band = |index: usize| x.narrow(3, index * channels, channels);
    let (top_sum, bottom_sum) = butterfly(&band(0)?, &band(1)?)?;
    let (top_difference, bottom_difference) = butterfly(&band(2)?, &band(3)?)?;
    let row = |sum: &Tensor, difference: &Tensor| -> Result<Tensor> {
        let (left, right) = butterfly(sum, difference)?;
        Ok(Tensor::stack(&[left, right], 3)?)
    };
    let top = row(&top_sum, &top_difference)?;
    let bottom = row(&bottom_sum, &bottom_difference)?;
    // (N, h, 2, w, 2, C)
    let cells = Tensor::stack(&[top, bottom], 2)?;
    Ok(cells.reshape((images, 2 * height, 2 * width, channels))?)
}

/// Sum and difference.
fn butterfly(a: &Tensor, b: &Tensor) -> Result<(Tensor, Tensor)> {
    Ok(((a + b)?, (a - b)?))
}

#[cfg(test)]
mod tests {
    use candle_core::{Device, Tensor};

    use super::*;

    fn values(x: &Tensor) -> Vec<f32> {
        x.flatten_all().unwrap().to_vec1().unwrap()
    }

    #[test]
    fn a_cell_gives_its_four_bands_in_order() {
        let cell = Tensor::new(&[1f32, 2.0, 3.0, 8.0], &Device::Cpu).unwrap();
        let bands = split(&cell.reshape((1, 2, 2, 1)).unwrap()).unwrap();
        assert_eq!(bands.dims(), [1, 1, 1, 4]);
        assert_eq!(values(&bands), [3.5, -2.0, -1.5, 1.0]);
    }

    #[test]
    fn bands_come_before_channels() {
        // Two channels, constant in the cell: only LL is not zero.
        let cell = Tensor::new(&[5f32, 7.0], &Device::Cpu).unwrap();
        let cell = cell.broadcast_as((1, 2, 2, 2)).unwrap();
        let bands = split(&cell.contiguous().unwrap()).unwrap();
        assert_eq!(values(&bands), [5.0, 7.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn two_levels_and_back_are_exact() {
        // 8-bit pixels in 0..1: sums of 16 of them need 12 bits, so f32 rounds nowhere.
        let count = 2 * 8 * 12 * 3;
        let pixels: Vec<f32> = (0..count).map(|i| (i * 37 % 256) as f32 / 256.0).collect();
        let image = Tensor::from_vec(pixels, (2, 8, 12, 3), &Device::Cpu).unwrap();
        let bands = split(&split(&image).unwrap()).unwrap();
        assert_eq!(bands.dims(), [2, 2, 3, 48]);
        let again = join(&join(&bands).unwrap()).unwrap();
        assert_eq!(again.dims(), image.dims());
        assert_eq!(values(&again), values(&image));
    }

    #[test]
    fn odd_sizes_and_broken_bands_are_refused() {
        let zeros = |shape: (usize, usize, usize, usize)| {
            Tensor::zeros(shape, candle_core::DType::F32, &Device::Cpu).unwrap()
        };
        let odd = split(&zeros((1, 3, 4, 3))).unwrap_err().to_string();
        assert!(odd.contains("Haar input"), "{odd}");
        let six = join(&zeros((1, 2, 2, 6))).unwrap_err().to_string();
        assert!(six.contains("Haar bands"), "{six}");
    }
}
