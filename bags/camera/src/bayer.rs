//! Demosaicing of Bayer patterns.

use cv_convert::ndarray::ArrayView2;

/// Converts a mosaic to RGB: each missing colour of a pixel is the mean of its neighbours (bilinear, as in cv_bridge).
/// `red` is column and row of the first red pixel.
pub(crate) fn demosaic(mosaic: ArrayView2<'_, u8>, (red_x, red_y): (usize, usize)) -> Vec<u8> {
    let (height, width) = mosaic.dim();
    let mut rgb = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        // At an edge, the pixel on the other side has the same colour; a picture of one row has none.
        let rows = [mirror(y, height, false), y, mirror(y, height, true)];
        let is_red_row = y % 2 == red_y;
        for x in 0..width {
            let columns = [mirror(x, width, false), x, mirror(x, width, true)];
            let at = |row: usize, column: usize| {
                let place = (rows.get(row), columns.get(column));
                let value = match place {
                    (Some(row), Some(column)) => mosaic.get((*row, *column)),
                    _ => None,
                };
                value.copied().map_or(0, u32::from)
            };
            let here = at(1, 1);
            let across = (at(1, 0) + at(1, 2)).div_ceil(2);
            let down = (at(0, 1) + at(2, 1)).div_ceil(2);
            let beside = (at(0, 1) + at(1, 0) + at(1, 2) + at(2, 1) + 2) / 4;
            let corners = (at(0, 0) + at(0, 2) + at(2, 0) + at(2, 2) + 2) / 4;
            let colour = match (is_red_row, x % 2 == red_x) {
                (true, true) => [here, beside, corners],
                (true, false) => [across, here, down],
                (false, true) => [down, here, across],
                (false, false) => [corners, beside, here],
            };
            // Fits: means of bytes.
            rgb.extend(colour.map(|value| value as u8));
        }
    }
    rgb
}

/// The neighbour before or after `at`, mirrored at the edges.
fn mirror(at: usize, length: usize, is_after: bool) -> usize {
    let last = length.saturating_sub(1);
    let neighbour = match (is_after, at) {
        (true, at) if at < last => at + 1,
        (false, at) if at > 0 => at - 1,
        (true, _) => at.saturating_sub(1),
        (false, _) => at + 1,
    };
    neighbour.min(last)
}
