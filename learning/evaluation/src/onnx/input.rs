//! Converts pictures to network inputs.

use image::RgbImage;

use crate::onnx::resample::resized;
use crate::onnx::{Channels, Input, Layout, Resize, Size, Tensor};

/// A longer side beyond this is a mistake in the settings.
const MAX_LONGER_SIDE: usize = 16_384;

/// Expectation and finding.
pub(crate) type Mismatch = (String, String);

/// A picture for the network: pixel by pixel, colours interleaved.
#[derive(Clone)]
pub(crate) struct Prepared {
    /// Height and width.
    pub(crate) size: [usize; 2],
    pixels: Vec<f32>,
}

impl Input {
    /// Resizes, crops and normalises a picture, in this order, without rounding in between.
    pub(crate) fn prepare(&self, picture: &RgbImage) -> Result<Prepared, Mismatch> {
        let from = size_of(picture);
        if from.contains(&0) {
            return Err(("a picture".to_owned(), text(from)));
        }
        let to = self.size_after_resize(from)?;
        let mut pixels: Vec<f32> = picture.as_raw().iter().copied().map(f32::from).collect();
        if to != from {
            let kernel = (self.resize, self.antialias.unwrap_or(false));
            pixels = resized(&pixels, from, to, 3, kernel);
        }
        let (size, mut pixels) = match self.crop {
            Some(crop) => (crop, cut(&pixels, to, crop)?),
            None => (to, pixels),
        };
        self.normalise(&mut pixels);
        Ok(Prepared { size, pixels })
    }

    fn size_after_resize(&self, from: [usize; 2]) -> Result<[usize; 2], Mismatch> {
        let [height, width] = from;
        let to = match self.size {
            None => from,
            Some(Size::Exact(size)) => size,
            Some(Size::Shorter(shorter)) => {
                let longer = shorter * height.max(width) / height.min(width).max(1);
                if longer > MAX_LONGER_SIDE {
                    let limit =
                        format!("a longer side of at most {MAX_LONGER_SIDE} after the resize");
                    return Err((limit, text(from)));
                }
                if height <= width {
                    [shorter, longer]
                } else {
                    [longer, shorter]
                }
            }
        };
        if self.resize == Resize::None && to != from {
            return Err((format!("{} (resize: none)", text(to)), text(from)));
        }
        Ok(to)
    }

    fn normalise(&self, pixels: &mut [f32]) {
        let [low, high] = self.range;
        let (pixels, _) = pixels.as_chunks_mut::<3>();
        for pixel in pixels {
            if self.channels == Channels::Bgr {
                pixel.reverse();
            }
            for ((level, mean), std) in pixel.iter_mut().zip(self.mean).zip(self.std) {
                *level = ((*level / 255.0) * (high - low) + low - mean) / std;
            }
        }
    }
}

/// Pictures of one size as one input: pictures if `frames` is `None`, else clips of that length.
pub(crate) fn arranged(
    pictures: &[Prepared],
    layout: Layout,
    frames: Option<usize>,
) -> Option<Tensor> {
    let [height, width] = pictures.first()?.size;
    if pictures
        .iter()
        .any(|picture| picture.size != [height, width])
    {
        return None;
    }
    let count = pictures.len();
    // Single pictures are clips of one frame.
    let frames = frames.unwrap_or(1).max(1);
    let clips = count / frames;
    let mut data = Vec::with_capacity(count * height * width * 3);
    for clip in pictures.chunks_exact(frames) {
        match layout {
            Layout::Nhwc => clip
                .iter()
                .for_each(|picture| data.extend_from_slice(&picture.pixels)),
            Layout::Nchw | Layout::Ntchw => {
                for picture in clip {
                    (0..3).for_each(|channel| data.extend(picture.plane(channel)));
                }
            }
            Layout::Ncthw => {
                for channel in 0..3 {
                    clip.iter()
                        .for_each(|picture| data.extend(picture.plane(channel)));
                }
            }
        }
    }
    let shape = match layout {
        Layout::Nchw => vec![count, 3, height, width],
        Layout::Nhwc => vec![count, height, width, 3],
        Layout::Ncthw => vec![clips, 3, frames, height, width],
        Layout::Ntchw => vec![clips, frames, 3, height, width],
    };
    Tensor::new(shape, data)
}

impl Prepared {
    fn plane(&self, channel: usize) -> impl Iterator<Item = f32> {
        self.pixels.iter().skip(channel).step_by(3).copied()
    }
}

/// Height and width.
pub(crate) fn size_of(picture: &RgbImage) -> [usize; 2] {
    // u32 fits into usize on all supported machines.
    [picture.height() as usize, picture.width() as usize]
}

/// A size for messages, width first.
pub(crate) fn text([height, width]: [usize; 2]) -> String {
    format!("{width}x{height}")
}

/// Crops the middle. An odd margin is split as in torchvision's `center_crop`, whose `round` goes to even numbers.
fn cut(pixels: &[f32], from: [usize; 2], to: [usize; 2]) -> Result<Vec<f32>, Mismatch> {
    let ([from_height, from_width], [height, width]) = (from, to);
    if from_height < height || from_width < width {
        let least = format!("at least {} after the resize, for the crop", text(to));
        return Err((least, text(from)));
    }
    let begin = |rest: usize| (rest as f64 / 2.0).round_ties_even() as usize;
    let (top, left) = (begin(from_height - height), begin(from_width - width));
    Ok(pixels
        .chunks_exact(from_width * 3)
        .skip(top)
        .take(height)
        .flat_map(|row| row.iter().skip(left * 3).take(width * 3))
        .copied()
        .collect())
}

#[cfg(test)]
mod tests;
