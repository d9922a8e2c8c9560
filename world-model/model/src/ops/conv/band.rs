//! A band of input rows with its zero border, as the kernels need it.

/// Where a band lies in its image.
#[derive(Clone, Copy)]
pub(super) struct Band {
    /// Size of the image (rows, columns, channels) in memory.
    pub image: (usize, usize, usize),
    /// First row and column; negative ones are border.
    pub origin: (isize, isize),
    /// Rows and columns of the band.
    pub size: (usize, usize),
}

impl Band {
    /// Copies the band out of `image` into the front of `buffer`, zeros outside of the image. The buffer never gets shorter:
    /// what is added is filled with zeros first, which costs as much as the copy.
    pub(super) fn copy(&self, image: &[f32], buffer: &mut Vec<f32>) {
        let (height, width, channels) = self.image;
        let (rows, columns) = self.size;
        let pitch = columns * channels;
        if buffer.len() < rows * pitch {
            buffer.resize(rows * pitch, 0.0);
        }
        for (r, target) in buffer.chunks_exact_mut(pitch).take(rows).enumerate() {
            let y = self.origin.0 + r as isize;
            let source = usize::try_from(y)
                .ok()
                .filter(|y| *y < height)
                .and_then(|y| image.get(y * width * channels..(y + 1) * width * channels));
            match source {
                None => target.fill(0.0),
                Some(source) => self.copy_row(source, target),
            }
        }
    }

    fn copy_row(&self, source: &[f32], target: &mut [f32]) {
        let (_, width, channels) = self.image;
        let left = self.origin.1;
        let columns = self.size.1;
        let border = left.min(0).unsigned_abs().min(columns);
        let skip = left.max(0).unsigned_abs().min(width);
        let count = (width - skip).min(columns - border);
        let (before, rest) = target.split_at_mut(border * channels);
        let (inside, after) = rest.split_at_mut(count * channels);
        before.fill(0.0);
        after.fill(0.0);
        if let Some(source) = source.get(skip * channels..(skip + count) * channels) {
            inside.copy_from_slice(source);
        }
    }
}
