//! A band of input pixels with its zero border, as the kernels need it.

use std::cell::RefCell;

use half::bf16;

use crate::ops::element::Element;
use crate::ops::group_norm::Normalisation;

/// Pixels that are normalised together, so that they are still in a first-level cache when they are rounded.
const PIXELS: usize = 8;

/// Where a band lies in its image.
#[derive(Clone, Copy)]
pub(super) struct Band {
    /// Size of the image (rows, columns, channels) in memory.
    pub image: (usize, usize, usize),
    /// First row and column; negative ones are border.
    pub origin: (isize, isize),
    /// Rows and columns of the band.
    pub size: (usize, usize),
    /// Channels of a pixel of the band; those that the image does not have are zeros.
    pub channels: usize,
}

/// The memory of a band.
#[derive(Debug, Default)]
pub(super) struct BandBuffer<T> {
    /// (rows, columns, channels) of the band in front, then what earlier bands have left.
    pub values: Vec<T>,
    normalised: Vec<f32>,
}

/// Numbers that a band may be of.
pub(super) trait Banded: Element {
    /// Calls `use_it` with the thread's buffer.
    fn with_buffer<R>(use_it: impl FnOnce(&mut BandBuffer<Self>) -> R) -> R;
}

macro_rules! banded {
    ($number:ty) => {
        impl Banded for $number {
            fn with_buffer<R>(use_it: impl FnOnce(&mut BandBuffer<Self>) -> R) -> R {
                thread_local! {
                    static BUFFER: RefCell<BandBuffer<$number>> = RefCell::default();
                }
                BUFFER.with_borrow_mut(use_it)
            }
        }
    };
}

banded!(f32);
banded!(bf16);

impl Band {
    /// Copies the band out of `image`, normalised if need be, zeros outside of the image. The buffer never gets shorter:
    /// what is added is filled with zeros first, which costs as much as the copy.
    pub(super) fn copy<T: Element>(
        &self,
        image: &[f32],
        normalisation: Option<&Normalisation>,
        buffer: &mut BandBuffer<T>,
    ) {
        let (height, width, channels) = self.image;
        let (rows, columns) = self.size;
        let pitch = columns * self.channels;
        let BandBuffer { values, normalised } = buffer;
        if values.len() < rows * pitch {
            values.resize(rows * pitch, T::ZERO);
        }
        let left = self.origin.1;
        let border = left.min(0).unsigned_abs().min(columns);
        let skip = left.max(0).unsigned_abs().min(width);
        let count = (width - skip).min(columns - border);
        for (r, target) in values.chunks_exact_mut(pitch.max(1)).take(rows).enumerate() {
            let y = usize::try_from(self.origin.0 + r as isize).ok();
            let source = y.filter(|y| *y < height).and_then(|y| {
                let at = (y * width + skip) * channels;
                image.get(at..at + count * channels)
            });
            let Some(source) = source else {
                target.fill(T::ZERO);
                continue;
            };
            let (before, rest) = target.split_at_mut(border * self.channels);
            let (inside, after) = rest.split_at_mut(count * self.channels);
            before.fill(T::ZERO);
            after.fill(T::ZERO);
            match normalisation {
                None => self.write(source, inside),
                Some(normalisation) => {
                    let sources = source.chunks(PIXELS * channels);
                    for (source, target) in sources.zip(inside.chunks_mut(PIXELS * self.channels)) {
                        normalised.resize(source.len(), 0.0);
                        normalisation.apply_to(source, normalised);
                        self.write(normalised, target);
                    }
                }
            }
        }
    }

    /// Rounds pixels of the image to pixels of the band.
    fn write<T: Element>(&self, source: &[f32], target: &mut [T]) {
        let (_, _, channels) = self.image;
        if channels == self.channels {
            return T::round(source, target);
        }
        let pixels = target.chunks_exact_mut(self.channels);
        for (source, target) in source.chunks_exact(channels).zip(pixels) {
            let (inside, rest) = target.split_at_mut(channels);
            T::round(source, inside);
            rest.fill(T::ZERO);
        }
    }
}
