//! A rectangle in a picture, cut out and resized.

use fast_image_resize::images::{TypedCroppedImage, TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use image::{RgbImage, imageops};

use super::picture_size::PictureSize;
use crate::{Error, Result};

/// A rectangle of whole pixels in a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Columns at its left.
    pub x: u32,
    /// Rows above it.
    pub y: u32,
    /// Its columns, at least 1.
    pub width: u32,
    /// Its rows, at least 1.
    pub height: u32,
}

impl Part {
    pub(super) fn whole(size: PictureSize) -> Self {
        Self {
            x: 0,
            y: 0,
            width: size.width,
            height: size.height,
        }
    }

    /// The largest rectangle of the aspect of `shape` in the middle of a picture of the size `of`.
    pub(super) fn inside(of: PictureSize, shape: PictureSize) -> Self {
        // At most `most`, which has 32 bits.
        let rounded = |side: u32, by: u32, over: u32, most: u32| {
            let (product, over) = (u64::from(side) * u64::from(by), u64::from(over));
            ((product + over / 2) / over).clamp(1, u64::from(most)) as u32
        };
        let is_wider = of.cross(shape) > shape.cross(of);
        let (width, height) = match is_wider {
            true => (
                rounded(of.height, shape.width, shape.height, of.width),
                of.height,
            ),
            false => (
                of.width,
                rounded(of.width, shape.height, shape.width, of.height),
            ),
        };
        Self {
            x: (of.width - width) / 2,
            y: (of.height - height) / 2,
            width,
            height,
        }
    }
    /// This part of `rgb`, resized to `width` x `height`, bilinear with antialiasing. No pixel outside the part contributes.
    pub(super) fn resize(self, rgb: &RgbImage, (width, height): (u32, u32)) -> Result<RgbImage> {
        if (self.width, self.height) == (width, height) {
            if (width, height) == rgb.dimensions() {
                return Ok(rgb.clone());
            }
            return Ok(imageops::crop_imm(rgb, self.x, self.y, width, height).to_image());
        }
        let fail = |reason: String| Error::config("image size", reason);
        let whole = TypedImageRef::<U8x3>::from_buffer(rgb.width(), rgb.height(), rgb.as_raw())
            .map_err(|e| fail(e.to_string()))?;
        let Part {
            x,
            y,
            width: columns,
            height: rows,
        } = self;
        // A view and not the resizer's own crop, whose filter reads pixels beside the part.
        let source = TypedCroppedImage::from_ref(&whole, x, y, columns, rows)
            .map_err(|e| fail(e.to_string()))?;
        let mut bytes = vec![0; height as usize * width as usize * 3];
        let mut target = TypedImage::<U8x3>::from_buffer(width, height, &mut bytes)
            .map_err(|e| fail(e.to_string()))?;
        let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
        // Typed: the untyped call compiles every filter for every pixel type, a minute of build time.
        Resizer::new()
            .resize_typed(&source, &mut target, &options)
            .map_err(|e| fail(e.to_string()))?;
        RgbImage::from_raw(width, height, bytes)
            .ok_or_else(|| fail(format!("{height}x{width} does not match the resized data")))
    }
}
