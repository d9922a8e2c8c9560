//! Colours of a sensor whose pixels see one colour each.

use cv_convert::ndarray::ArrayView2;

/// RGB of a mosaic: each colour that a pixel lacks is the mean of its neighbours that have it (bilinear, as in cv_bridge).
/// `red` is column and row of the first red pixel.
pub(crate) fn demosaiced(mosaic: ArrayView2<'_, u8>, (red_x, red_y): (usize, usize)) -> Vec<u8> {
    let (height, width) = mosaic.dim();
    let mut rgb = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        // At an edge the pixel on the other side stands in, which has the same colour; a picture of one row has none.
        let rows = [mirrored(y, height, false), y, mirrored(y, height, true)];
        let is_red_row = y % 2 == red_y;
        for x in 0..width {
            let columns = [mirrored(x, width, false), x, mirrored(x, width, true)];
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
            // Means of bytes.
            rgb.extend(colour.map(|value| value as u8));
        }
    }
    rgb
}

/// The neighbour of a place, after or before it.
fn mirrored(at: usize, length: usize, is_after: bool) -> usize {
    let last = length.saturating_sub(1);
    let neighbour = match (is_after, at) {
        (true, at) if at < last => at + 1,
        (false, at) if at > 0 => at - 1,
        (true, _) => at.saturating_sub(1),
        (false, _) => at + 1,
    };
    neighbour.min(last)
}
