use image::{
    GrayImage,
    imageops::{self, FilterType},
};
use wm_model::{Fit, Part, PictureSize, Placement};

use super::Size;

/// Places a mask as its picture; bars become background.
pub(super) fn place(mask: &GrayImage, size: Size, fit: Fit) -> GrayImage {
    let (width, height) = mask.dimensions();
    let to = PictureSize::from(size);
    let Some(Placement { source, target }) = fit.placement(PictureSize { width, height }, to)
    else {
        return GrayImage::new(to.width, to.height);
    };
    let cut = |Part {
                   x,
                   y,
                   width,
                   height,
               }: Part| imageops::crop_imm(mask, x, y, width, height);
    let scaled = shrink(
        &cut(source).to_image(),
        Size {
            height: target.height as usize,
            width: target.width as usize,
        },
    );
    let mut placed = GrayImage::new(to.width, to.height);
    imageops::replace(
        &mut placed,
        &scaled,
        i64::from(target.x),
        i64::from(target.y),
    );
    placed
}

/// Nearest neighbour: class numbers must not be blended.
pub(super) fn shrink(mask: &GrayImage, size: Size) -> GrayImage {
    // A side is at most 4096.
    let (width, height) = (size.width as u32, size.height as u32);
    imageops::resize(mask, width, height, FilterType::Nearest)
}
