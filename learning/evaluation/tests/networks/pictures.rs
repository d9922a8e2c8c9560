//! The pictures and numbers of `fixtures/generate.py`.

use std::collections::BTreeMap;
use std::path::Path;

use image::{Rgb, RgbImage};
use serde::Deserialize;
use wm_evaluation::onnx::Networks;

/// PyTorch's results.
#[derive(Deserialize)]
pub struct Golden {
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
}

pub fn results() -> BTreeMap<String, Golden> {
    serde_json::from_str(include_str!("../../fixtures/results.json")).unwrap()
}

/// A texture without repetition; `shift` moves it.
pub fn picture((width, height): (u32, u32), seed: u32, shift: (i32, i32)) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let x = x.wrapping_add_signed(64 - shift.0);
        let y = y.wrapping_add_signed(64 - shift.1);
        Rgb([0, 1, 2].map(|channel: u32| {
            let hash = x
                .wrapping_mul(374_761_393)
                .wrapping_add(y.wrapping_mul(668_265_263))
                .wrapping_add((channel + seed * 3).wrapping_mul(2_246_822_519));
            ((hash ^ (hash >> 13)).wrapping_mul(1_274_126_177) >> 24) as u8
        }))
    })
}

/// Networks of `fixtures/`, described by `text`.
pub fn networks(text: &str) -> Networks {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    Networks::parse(text, folder.join("networks.yaml")).unwrap()
}

/// Largest difference, relative to a largest value above 1.
pub fn far(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let largest = expected
        .iter()
        .fold(1.0, |largest: f32, value| largest.max(value.abs()));
    let far = found
        .iter()
        .zip(expected)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    far / largest
}
