use crate::onnx::{Query, Tracks};
use anyhow::Result;
use image::RgbImage;
use wm_metrics::{MetricError, motion::point_coverage};

use super::RolloutPictures;

/// Points per side of the grid.
const SIDE: usize = 16;
/// Width of a picture relative to the grid's margin, as in CoTracker's `get_points_on_a_grid`.
const WIDTHS_OF_MARGIN: f32 = 64.0;

/// Share of the first observed frame's points that are visible in each predicted frame (the paper, appendix C.2).
pub(super) fn coverage(
    network: &Tracks,
    pictures: &RolloutPictures<'_>,
) -> Result<Result<Vec<f64>, MetricError>> {
    let video = [pictures.observed, pictures.predicted].concat();
    let Some((width, height)) = video.first().map(RgbImage::dimensions) else {
        return Ok(point_coverage::<Vec<bool>>(&[]).map(|coverage| coverage.per_step));
    };
    let tracks = network.follow(&video, &grid(width, height))?;
    let steps = (pictures.observed.len()..video.len()).map(|step| -> Vec<bool> {
        let at = tracks.iter().map(|track| track.get(step));
        at.map(|point| point.is_some_and(|point| point.visible))
            .collect()
    });
    let visible: Vec<Vec<bool>> = steps.collect();
    Ok(point_coverage(&visible).map(|coverage| coverage.per_step))
}

/// Points of the first frame of a video, row by row.
fn grid(width: u32, height: u32) -> Vec<Query> {
    // Sides of pictures are exact in f32.
    let margin = width as f32 / WIDTHS_OF_MARGIN;
    let places = |side: u32| -> Vec<f32> {
        let side = side as f32;
        let at = |index| margin + (side - 2.0 * margin) * index as f32 / (SIDE - 1) as f32;
        // Below 64 px of width, the last point would lie beyond the last pixel.
        let last = (side - 1.0).max(0.0);
        (0..SIDE).map(|index| at(index).clamp(0.0, last)).collect()
    };
    let (columns, rows) = (places(width), places(height));
    let points = rows
        .iter()
        .flat_map(|y| columns.iter().map(move |x| (*x, *y)));
    points.map(|(x, y)| Query { step: 0, x, y }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_matches_cotracker() {
        // get_points_on_a_grid(16, (384, 512)): from 8 to 504 across, from 8 to 376 down.
        let points = grid(512, 384);
        assert_eq!(points.len(), 256);
        let near = |point: &Query, x: f32, y: f32| {
            assert!(
                (point.x - x).abs() < 1e-3 && (point.y - y).abs() < 1e-3,
                "{point:?}"
            );
        };
        near(&points[0], 8.0, 8.0);
        near(&points[1], 8.0 + 496.0 / 15.0, 8.0);
        near(&points[16], 8.0, 8.0 + 368.0 / 15.0);
        near(&points[255], 504.0, 376.0);
    }

    #[test]
    fn points_are_inside_the_picture() {
        for (width, height) in [(32, 32), (1, 1), (200, 3)] {
            let (right, bottom) = ((width - 1) as f32, (height - 1) as f32);
            let points = grid(width, height);
            let are_inside = points
                .iter()
                .all(|p| (0.0..=right).contains(&p.x) && (0.0..=bottom).contains(&p.y));
            assert!(are_inside, "{width}x{height}: {points:?}");
        }
    }
}
