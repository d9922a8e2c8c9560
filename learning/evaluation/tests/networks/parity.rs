//! Parity of all networks with PyTorch.

use image::RgbImage;
use wm_evaluation::onnx::{Error, Query, Role};

use super::pictures::{far, networks, picture, results};

const NEAR: f32 = 1e-4;

const ALL: &str = "
fid:
  file: convolutions.onnx
  input: { resize: bilinear, antialias: true, size: [33, 35], range: [0, 1] }
  pooling: space
  batch: 2
subject:
  file: transformer.onnx
  input: { resize: bicubic, antialias: false, size: [32, 32], range: [0, 1] }
  output: tokens
  pooling: first_token
jepa:
  file: transformer.onnx
  input: { resize: bicubic, antialias: false, size: [32, 32], range: [0, 1] }
  pooling: tokens
  batch: 3
fvd:
  file: clip.onnx
  input: { resize: bilinear, antialias: false, size: [112, 112], range: [-1, 1] }
musiq:
  file: score.onnx
  input: { resize: none, range: [0, 1] }
  score_range: [0, 100]
aesthetic:
  file: score.onnx
  input: { resize: none, range: [0, 1] }
lpips:
  file: distance.onnx
  input: { resize: none, range: [-1, 1] }
  batch: 2
flow:
  file: flow.onnx
  input: { resize: none, range: [0, 1] }
depth:
  file: depth.onnx
  input: { resize: none, range: [0, 1] }
tracks:
  file: tracks.onnx
  input: { resize: none, range: [0, 255] }
";

fn pictures(size: (u32, u32), count: u32) -> Vec<RgbImage> {
    (0..count).map(|seed| picture(size, seed, (0, 0))).collect()
}

#[test]
fn features_of_pictures_match_pytorch() {
    let (networks, golden) = (networks(ALL), results());
    let pictures = pictures((40, 30), 3);
    for (role, name) in [
        (Role::Fid, "convolutions"),
        (Role::Subject, "transformer_first"),
        (Role::Jepa, "transformer_tokens"),
    ] {
        let features = networks.features(role).unwrap();
        let found = features.of(&pictures).unwrap();
        assert_eq!(found.len(), 3, "{role}");
        let far = far(&found.concat(), &golden[name].values);
        assert!(far < NEAR, "{role}: {far} off");
        assert_eq!(
            features.of(&pictures).unwrap(),
            found,
            "{role}: not the same again"
        );
        let alone = features.of(&pictures[1..2]).unwrap();
        if features.network().spec().batch == 1 {
            assert_eq!(alone[0], found[1], "{role}: not the same alone");
        } else {
            // The position in the batch may change the order of a sum.
            assert!(super::pictures::far(&alone[0], &found[1]) < 1e-6, "{role}");
        }
        assert!(features.of(&[]).unwrap().is_empty());
    }
}

#[test]
fn features_of_clips_match_pytorch() {
    let network = networks(ALL).clip_features(Role::Fvd).unwrap();
    assert_eq!(network.frames(), 16);
    let clip = pictures((128, 120), 16);
    let found = network.of(&[&clip, &clip]).unwrap();
    assert_eq!(found[0], found[1]);
    let far = far(&found[0], &results()["clip"].values);
    assert!(far < NEAR, "{far} off");
    let error = network.of(&[&clip[1..]]).unwrap_err().to_string();
    assert_eq!(error, "fvd: pictures of a clip: expected 16, found 15");
}

#[test]
fn scores_and_distances_match_pytorch() {
    let (networks, golden) = (networks(ALL), results());
    let scores = networks
        .scores(Role::Musiq)
        .unwrap()
        .of(&pictures((16, 16), 2))
        .unwrap();
    let raw: Vec<f32> = scores.iter().map(|score| score.raw).collect();
    assert!(far(&raw, &golden["score"].values) < NEAR);
    assert!((scores[0].normalised - raw[0] / 100.0).abs() < 1e-6);
    // About 45, on a scale that ends at 10.
    let scores = networks
        .scores(Role::Aesthetic)
        .unwrap()
        .of(&pictures((16, 16), 1))
        .unwrap();
    assert_eq!(scores[0].normalised, 1.0);

    let network = networks.distance().unwrap();
    let pictures = pictures((16, 12), 7);
    let pairs = [
        (&pictures[0], &pictures[5]),
        (&pictures[1], &pictures[6]),
        (&pictures[0], &pictures[0]),
    ];
    let found = network.between(&pairs).unwrap();
    assert!(far(&found[..2], &golden["distance"].values) < NEAR);
    assert_eq!(found[2], 0.0);
}

#[test]
fn flow_finds_a_shift() {
    let network = networks(ALL).flow().unwrap();
    let [first, second] = [(0, 0), (2, -1)].map(|shift| picture((40, 32), 0, shift));
    let found = network.between(&first, &second).unwrap();
    assert_eq!((found.width, found.height), (40, 32));
    let both = [found.u, found.v].concat();
    assert!(far(&both, &results()["flow"].values) < 3.0 * NEAR);
    let error = network
        .between(&first, &picture((40, 31), 0, (0, 0)))
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "flow: second picture (width x height): expected 40x32, found 40x31"
    );
}

/// At half the width and a third of the height, the network sees half and a third of the shift.
#[test]
fn flow_is_scaled_back() {
    let text =
        "flow: { file: flow.onnx, input: { resize: nearest, size: [32, 40], range: [0, 1] } }";
    let network = networks(text).flow().unwrap();
    let enlarged = |shift| {
        let small = picture((40, 32), 0, shift);
        RgbImage::from_fn(80, 96, |x, y| *small.get_pixel(x / 2, y / 3))
    };
    let found = network
        .between(&enlarged((0, 0)), &enlarged((2, -1)))
        .unwrap();
    assert_eq!(
        (found.width, found.height, found.u.len()),
        (80, 96, 80 * 96)
    );
    for (x, y) in [(40, 48), (30, 60), (25, 33)] {
        let (u, v) = (found.u[y * 80 + x], found.v[y * 80 + x]);
        assert!(
            (u - 4.0).abs() < 0.1 && (v + 3.0).abs() < 0.1,
            "({u}, {v}) at ({x}, {y})"
        );
    }
}

#[test]
fn depth_matches_pytorch() {
    let network = networks(ALL).depth().unwrap();
    let found = network.of(&picture((24, 16), 0, (0, 0))).unwrap();
    assert_eq!((found.width, found.height), (24, 16));
    assert!(far(&found.values, &results()["depth"].values) < NEAR);

    let error = network.of(&picture((24, 18), 0, (0, 0))).unwrap_err();
    assert!(matches!(error, Error::Shape { .. }));
    let error = error.to_string();
    assert!(
        error.starts_with("depth: ") && error.contains("depth.onnx: input `x`"),
        "{error}"
    );
    assert!(
        error.ends_with("expected [1, 3, 16, 24], found [1, 3, 18, 24]"),
        "{error}"
    );

    let text =
        "depth: { file: depth.onnx, input: { resize: nearest, size: [16, 24], range: [0, 1] } }";
    let larger = networks(text)
        .depth()
        .unwrap()
        .of(&picture((50, 60), 0, (0, 0)))
        .unwrap();
    assert_eq!(
        (larger.width, larger.height, larger.values.len()),
        (50, 60, 3000)
    );
}

#[test]
fn points_are_tracked() {
    let network = networks(ALL).tracks().unwrap();
    let mut video: Vec<RgbImage> = (0..4)
        .map(|step| picture((32, 32), 0, (step, 2 * step)))
        .collect();
    video[3].pixels_mut().for_each(|pixel| pixel.0 = [128; 3]);
    let queries =
        [(0, 10.0, 10.0), (1, 15.0, 12.0), (0, 12.5, 9.0)].map(|(step, x, y)| Query { step, x, y });
    let found = network.follow(&video, &queries).unwrap();

    // The network orders by step, ours by point.
    let (mut places, mut visible) = (Vec::new(), Vec::new());
    for step in 0..4 {
        for track in &found {
            places.extend([track[step].x, track[step].y]);
            visible.push(track[step].visibility);
        }
    }
    let golden = results();
    assert_eq!(golden["tracks"].shape, [1, 4, 3, 2]);
    assert!(far(&places, &golden["tracks"].values) < NEAR);
    assert!(far(&visible, &golden["visible"].values) < NEAR);
    for (step, point) in found[0].iter().enumerate() {
        assert_eq!(point.visible, step < 3, "the last picture is blank");
    }

    assert!(
        network
            .follow(&[], &queries)
            .unwrap()
            .iter()
            .all(Vec::is_empty)
    );
    let late = Query {
        step: 4,
        ..queries[0]
    };
    let error = network.follow(&video, &[late]).unwrap_err().to_string();
    assert!(error.starts_with("tracks: queries: expected"), "{error}");
}

#[test]
fn points_are_scaled() {
    let text = "tracks: { file: tracks.onnx, input: { resize: nearest, size: [32, 32], range: [0, 255] } }";
    let network = networks(text).tracks().unwrap();
    let video: Vec<RgbImage> = (0..3)
        .map(|step| {
            let small = picture((32, 32), 0, (step, 0));
            RgbImage::from_fn(64, 96, |x, y| *small.get_pixel(x / 2, y / 3))
        })
        .collect();
    let found = network
        .follow(
            &video,
            &[Query {
                step: 0,
                x: 20.5,
                y: 31.0,
            }],
        )
        .unwrap();
    for (step, point) in found[0].iter().enumerate() {
        let far = (point.x - 20.5 - 2.0 * step as f32)
            .abs()
            .max((point.y - 31.0).abs());
        assert!(far < 0.01 && point.visible, "{point:?} at step {step}");
    }
}
