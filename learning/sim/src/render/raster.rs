//! Rasterises triangles to samples.

/// Calls `visit(index, weights, nearness)` for each sample centre of a `width` by `height` grid inside the triangle. Skips
/// triangles seen from behind if `cull` is set. Corners are x, y in samples, and nearness.
///
pub fn fill(
    (width, height): (usize, usize),
    [a, b, c]: [[f32; 3]; 3],
    cull: bool,
    mut visit: impl FnMut(usize, [f32; 3], f32),
) {
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    // With y down the picture, counter-clockwise from outside has a negative area.
    if area.abs() < 1e-9 || (cull && area > 0.0) {
        return;
    }
    let range = |axis: usize, size: usize| {
        let low = a[axis].min(b[axis]).min(c[axis]).max(0.0);
        let high = a[axis].max(b[axis]).max(c[axis]).min(size as f32);
        // Fits: both are within 0..=size; a NaN becomes 0.
        (low.floor() as usize, high.ceil() as usize)
    };
    let (x_low, x_high) = range(0, width);
    let (y_low, y_high) = range(1, height);
    let scale = 1.0 / area;
    // Weight of a corner: the edge function of the opposite edge, linear in x and y.
    let edge = |from: [f32; 3], to: [f32; 3]| {
        let (dx, dy) = (-(to[1] - from[1]) * scale, (to[0] - from[0]) * scale);
        let constant = -(from[0] * dx + from[1] * dy);
        (dx, dy, constant)
    };
    let (edge_a, edge_b) = (edge(b, c), edge(c, a));
    for y in y_low..y_high {
        let centre_y = y as f32 + 0.5;
        for x in x_low..x_high {
            let centre_x = x as f32 + 0.5;
            let weight_a = edge_a.0 * centre_x + edge_a.1 * centre_y + edge_a.2;
            let weight_b = edge_b.0 * centre_x + edge_b.1 * centre_y + edge_b.2;
            let weight_c = 1.0 - weight_a - weight_b;
            if weight_a >= 0.0 && weight_b >= 0.0 && weight_c >= 0.0 {
                let nearness = weight_a * a[2] + weight_b * b[2] + weight_c * c[2];
                visit(y * width + x, [weight_a, weight_b, weight_c], nearness);
            }
        }
    }
}
