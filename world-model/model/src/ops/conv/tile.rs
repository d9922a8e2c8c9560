//! Rectangles of output pixels whose inputs fit into a cache.

/// Bytes that the inputs of a tile should have at most, so that they stay in a second-level cache beside the weights.
const BYTES: usize = 256 * 1024;

/// Columns that a tile has at most, and those that it has at least where the output has them: whole tiles of the kernel.
const MOST_COLUMNS: usize = 48;
const LEAST_COLUMNS: usize = 12;

/// Rows that a tile should have: every row of outputs reads the rows of taps around it again.
const ROWS: usize = 4;

/// How an output is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tile {
    height: usize,
    width: usize,
}

/// A rectangle of outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rectangle {
    pub(super) top: usize,
    pub(super) left: usize,
    pub(super) height: usize,
    pub(super) width: usize,
}

impl Tile {
    /// For outputs of `height` x `width`, `taps` (rows, columns) whose places lie `stride` apart, and `pixel` bytes of
    /// input a pixel.
    pub(super) fn new(
        (height, width): (usize, usize),
        taps: (usize, usize),
        stride: usize,
        pixel: usize,
    ) -> Self {
        let rows = |columns: usize| {
            let inputs = (columns - 1) * stride + taps.1;
            let rows = BYTES / (inputs * pixel).max(1);
            (rows.saturating_sub(taps.0) / stride + 1).min(height)
        };
        let mut columns = width.clamp(1, MOST_COLUMNS);
        while rows(columns) < ROWS.min(height) && columns > LEAST_COLUMNS {
            columns = (columns / 2).max(LEAST_COLUMNS);
        }
        Self {
            height: rows(columns).max(1),
            width: columns,
        }
    }

    /// Squares of `side` outputs.
    pub(super) fn square(side: usize) -> Self {
        Self {
            height: side.max(1),
            width: side.max(1),
        }
    }

    /// Cut further, where there are few images, so that there are tiles for several threads.
    pub(super) fn for_images(self, images: usize, height: usize) -> Self {
        if images >= 4 {
            return self;
        }
        Self {
            height: self.height.min(height.div_ceil(4)).max(1),
            ..self
        }
    }

    /// Tiles of an output of `height` x `width`.
    pub(super) fn count(self, height: usize, width: usize) -> usize {
        height.div_ceil(self.height) * width.div_ceil(self.width)
    }

    /// Number `number` of these.
    pub(super) fn part(self, number: usize, height: usize, width: usize) -> Rectangle {
        let across = width.div_ceil(self.width).max(1);
        let (top, left) = (number / across * self.height, number % across * self.width);
        Rectangle {
            top,
            left,
            height: self.height.min(height - top),
            width: self.width.min(width - left),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_cover_every_output_once() {
        for (height, width, stride, pixel) in [
            (256, 256, 1, 512),
            (32, 32, 1, 2048),
            (7, 129, 2, 256),
            (1, 1, 1, 1 << 20),
            (5, 100, 1, 1),
        ] {
            let tile = Tile::new((height, width), (3, 3), stride, pixel).for_images(1, height);
            let mut seen = vec![0; height * width];
            for number in 0..tile.count(height, width) {
                let part = tile.part(number, height, width);
                for y in part.top..part.top + part.height {
                    for x in part.left..part.left + part.width {
                        seen[y * width + x] += 1;
                    }
                }
            }
            assert!(
                seen.iter().all(|count| *count == 1),
                "{height} x {width}: {tile:?}"
            );
        }
    }

    #[test]
    fn inputs_of_a_tile_fit_into_the_cache() {
        for pixel in [512, 1024, 2048] {
            let tile = Tile::new((256, 256), (3, 3), 1, pixel);
            let inputs = (tile.height + 2) * (tile.width + 2) * pixel;
            assert!(
                inputs <= BYTES,
                "{tile:?} of {pixel} bytes a pixel: {inputs}"
            );
            assert!(tile.height >= ROWS, "{tile:?}");
        }
    }
}
