//! Converts raw image messages to RGB. Rows are read in place.

use cv_convert::{TryAsRefCv, TryToCv, ndarray};
use image::RgbImage;
use ndarray::{ArrayView2, ShapeBuilder as _};
use wm_msgs::sensor_msgs::Image;

use crate::{
    bayer::demosaic,
    encoding::Encoding,
    error::ImageError,
    limits::MAX_SIDE,
    yuv::{Plane, YuvColours, YuvTable},
};

/// A raw image message, for cv-convert's traits.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RosImage<'a>(pub &'a Image);

/// The layout of an image's rows.
#[derive(Clone, Copy, Debug)]
struct Rows {
    encoding: Encoding,
    /// Width and height \[px\].
    width: usize,
    height: usize,
    /// Distance between rows \[bytes\].
    step: usize,
}

impl Rows {
    fn of(image: &Image) -> Result<Self, ImageError> {
        let (width, height) = (image.width, image.height);
        let encoding = Encoding::of(&image.encoding)?;
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
            return Err(ImageError::Size { width, height });
        }
        // Sides are bounded, so only products with the step can overflow; those are widened.
        let (columns, rows) = (width as usize, height as usize);
        let needed = encoding.row_bytes(columns);
        let wrong_data = |step: usize, expected| ImageError::Data {
            actual: image.data.len(),
            expected,
            step,
            height,
        };
        let step = match image.step as usize {
            // Some drivers leave it 0 if rows have no padding.
            0 if image.data.len() == bytes(encoding, needed, (columns, rows)) => needed,
            step if step < needed => {
                return Err(ImageError::Step {
                    step: image.step,
                    width,
                    encoding: image.encoding.clone(),
                    needed,
                });
            }
            step => step,
        };
        let expected = bytes(encoding, step, (columns, rows));
        // Padding after the last row may be missing; bytes after it are ignored.
        if image.data.len() < expected {
            return Err(wrong_data(step, expected));
        }
        Ok(Self {
            encoding,
            width: columns,
            height: rows,
            step,
        })
    }
}

/// Minimum size of a picture, without padding after its last row \[bytes\].
fn bytes(encoding: Encoding, step: usize, (width, height): (usize, usize)) -> usize {
    let plane = |step: usize, rows: usize, row: usize| {
        step.saturating_mul(rows.saturating_sub(1))
            .saturating_add(row)
    };
    match encoding {
        Encoding::SemiPlanar { is_full_size, .. } => {
            let (step_of_pairs, rows, row) = pairs(is_full_size, step, (width, height));
            let luma = step.saturating_mul(height);
            luma.saturating_add(plane(step_of_pairs, rows, row))
        }
        _ => plane(step, height, encoding.row_bytes(width)),
    }
}

/// Step, number of rows and row bytes of the plane of differences.
fn pairs(
    is_full_size: bool,
    step: usize,
    (width, height): (usize, usize),
) -> (usize, usize, usize) {
    match is_full_size {
        true => (step.saturating_mul(2), height, width * 2),
        false => (step, height.div_ceil(2), width.div_ceil(2) * 2),
    }
}

/// The rows without padding (height, row bytes), in place; for encodings with several planes, those of the first.
impl<'a> TryAsRefCv<'a, ArrayView2<'a, u8>> for RosImage<'a> {
    type Error = ImageError;

    fn try_as_ref_cv(&'a self) -> Result<ArrayView2<'a, u8>, ImageError> {
        let rows = Rows::of(self.0)?;
        let row_bytes = rows.encoding.row_bytes(rows.width);
        let shape = (rows.height, row_bytes).strides((rows.step, 1));
        ArrayView2::from_shape(shape, &self.0.data).map_err(|_| ImageError::Data {
            actual: self.0.data.len(),
            expected: bytes(rows.encoding, rows.step, (rows.width, rows.height)),
            step: rows.step,
            height: self.0.height,
        })
    }
}

impl TryToCv<RgbImage> for RosImage<'_> {
    type Error = ImageError;

    fn try_to_cv(&self) -> Result<RgbImage, ImageError> {
        let rows = Rows::of(self.0)?;
        let view: ArrayView2<'_, u8> = self.try_as_ref_cv()?;
        let lines = view.rows();
        let lines = lines.into_iter().filter_map(|row| row.to_slice());
        let mut rgb = Vec::with_capacity(rows.width * rows.height * 3);
        match rows.encoding {
            Encoding::Pixels {
                bytes: 3,
                rgb: [0, 1, 2],
            } => lines.for_each(|row| rgb.extend_from_slice(row)),
            Encoding::Pixels { bytes, rgb: places } => {
                for row in lines {
                    for pixel in row.chunks_exact(bytes) {
                        // In range: each offset is below `bytes`.
                        let colour = places.map(|at| pixel.get(at).copied().unwrap_or(0));
                        rgb.extend(colour);
                    }
                }
            }
            Encoding::Yuv422 { luma, differences } => {
                let table = YuvTable::new(YuvColours::default());
                for row in lines {
                    let pixels = row.as_chunks::<4>().0.iter().flat_map(|pair| {
                        let [blue, red] = differences.map(|at| pair[at & 3]);
                        [luma, luma + 2].map(|at| table.rgb(pair[at & 3], blue, red))
                    });
                    rgb.extend(pixels.take(rows.width).flatten());
                }
            }
            Encoding::SemiPlanar {
                is_red_first,
                is_full_size,
            } => {
                let size = (rows.width, rows.height);
                let (step, _, length) = pairs(is_full_size, rows.step, size);
                let after = self.0.data.get(rows.step.saturating_mul(rows.height)..);
                let plane = Plane {
                    // `Rows::of` has checked the size: this plane is complete.
                    data: after.unwrap_or_default(),
                    stride: step,
                };
                let table = YuvTable::new(YuvColours::default());
                let share = if is_full_size { 1 } else { 2 };
                for (number, row) in lines.enumerate() {
                    let pairs = plane.row(number / share, length).unwrap_or_default();
                    let pairs = pairs.as_chunks::<2>().0;
                    for (lumas, [first, second]) in row.chunks(share).zip(pairs) {
                        let (blue, red) = match is_red_first {
                            true => (*second, *first),
                            false => (*first, *second),
                        };
                        rgb.extend(lumas.iter().flat_map(|luma| table.rgb(*luma, blue, red)));
                    }
                }
            }
            Encoding::Bayer { red } => rgb = demosaic(view, red),
        }
        RgbImage::from_raw(self.0.width, self.0.height, rgb).ok_or(ImageError::Size {
            width: self.0.width,
            height: self.0.height,
        })
    }
}
