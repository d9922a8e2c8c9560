use image::Rgb;
use serde::Deserialize;

use super::*;

/// PyTorch's result for a picture, from `fixtures/generate.py`.
#[derive(Deserialize)]
struct Golden {
    input: Input,
    width: u32,
    height: u32,
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// The picture of `fixtures/generate.py`, seed 0, no shift.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        Rgb([0, 1, 2].map(|channel: u32| {
            let hash = (x + 64)
                .wrapping_mul(374_761_393)
                .wrapping_add((y + 64).wrapping_mul(668_265_263))
                .wrapping_add(channel.wrapping_mul(2_246_822_519));
            ((hash ^ (hash >> 13)).wrapping_mul(1_274_126_177) >> 24) as u8
        }))
    })
}

#[test]
fn preparation_matches_pytorch() {
    let all: Vec<Golden> =
        serde_json::from_str(include_str!("../../../fixtures/preparations.json")).unwrap();
    assert!(all.len() > 30);
    for golden in all {
        let prepared = golden
            .input
            .prepare(&picture(golden.width, golden.height))
            .unwrap();
        let layout = golden.input.layout.unwrap_or(Layout::Nchw);
        let tensor = arranged(&[prepared], layout, None).unwrap();
        assert_eq!(tensor.shape(), golden.shape);
        let far = tensor
            .data()
            .iter()
            .zip(&golden.values)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        // PyTorch's weights are f32, and the normalised range is up to five.
        assert!(
            far < 1e-4,
            "{far} off: {:?} of {}x{}",
            golden.input,
            golden.width,
            golden.height
        );
    }
}

fn plain() -> Input {
    serde_json::from_str(r#"{"resize": "none", "range": [0, 255]}"#).unwrap()
}

#[test]
fn axes_follow_the_layout() {
    let pictures = [1_u8, 2].map(|level| {
        let picture = RgbImage::from_fn(2, 1, |x, _| {
            Rgb([level * 10 + x as u8, level * 10 + 2, level * 10 + 4])
        });
        plain().prepare(&picture).unwrap()
    });
    let arrange = |layout, frames| {
        let tensor = arranged(&pictures, layout, frames).unwrap();
        (tensor.shape().to_vec(), tensor.into_data())
    };
    let by_colour = vec![
        10.0, 11.0, 12.0, 12.0, 14.0, 14.0, 20.0, 21.0, 22.0, 22.0, 24.0, 24.0,
    ];
    assert_eq!(
        arrange(Layout::Nchw, None),
        (vec![2, 3, 1, 2], by_colour.clone())
    );
    assert_eq!(
        arrange(Layout::Ntchw, Some(2)),
        (vec![1, 2, 3, 1, 2], by_colour)
    );
    assert_eq!(
        arrange(Layout::Ncthw, Some(2)),
        (
            vec![1, 3, 2, 1, 2],
            vec![
                10.0, 11.0, 20.0, 21.0, 12.0, 12.0, 22.0, 22.0, 14.0, 14.0, 24.0, 24.0
            ]
        )
    );
    assert_eq!(
        arrange(Layout::Nhwc, None).1,
        [
            10.0, 12.0, 14.0, 11.0, 12.0, 14.0, 20.0, 22.0, 24.0, 21.0, 22.0, 24.0
        ]
    );
}

#[test]
fn unsuitable_pictures_are_named() {
    let mut input = plain();
    input.size = Some(Size::Exact([4, 5]));
    let found = input.prepare(&picture(6, 4)).map(|_| ());
    assert_eq!(
        found,
        Err(("5x4 (resize: none)".to_owned(), "6x4".to_owned()))
    );
    input.size = None;
    input.crop = Some([5, 5]);
    let found = input.prepare(&picture(6, 4)).map(|_| ());
    assert_eq!(found.unwrap_err().1, "6x4");
    assert!(plain().prepare(&RgbImage::new(0, 4)).is_err());

    input =
        serde_json::from_str(r#"{"resize": "nearest", "size": 4096, "range": [0, 1]}"#).unwrap();
    assert!(
        input.prepare(&picture(100, 1)).is_err(),
        "a strip, whose longer side would be 409600"
    );
    let sizes = [picture(2, 2), picture(3, 2)].map(|picture| plain().prepare(&picture).unwrap());
    assert!(arranged(&sizes, Layout::Nchw, None).is_none());
    assert!(arranged(&[], Layout::Nchw, None).is_none());
}
