#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use image::RgbImage;
use wm_camera::{
    camera_frame::CameraFrame,
    image_message::{encode_image, encode_jpeg},
};
use wm_msgs::std_msgs::Header;

use super::*;
use crate::encoder::Repetition;

const SECOND: i64 = 1_000_000_000;
const AFTER: Duration = Duration::from_secs(1);

/// Numbers that look random, the same in each run.
struct Noise(u64);

impl Noise {
    fn next(&mut self, most: i32) -> i32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as i32 % (2 * most + 1) - most
    }

    fn on(&mut self, picture: &RgbImage, most: i32) -> RgbImage {
        let mut noisy = picture.clone();
        for value in noisy.iter_mut().filter(|_| most > 0) {
            *value = (i32::from(*value) + self.next(most)).clamp(0, 255) as u8;
        }
        noisy
    }
}

/// A table 1 m wide with an arm of 5 cm on it, at `x` \[m\].
fn table(size: (u32, u32), x: f32) -> RgbImage {
    let width = size.0 as f32;
    RgbImage::from_fn(size.0, size.1, |column, row| {
        let is_arm = (column as f32 / width - x).abs() < 0.025 && row < size.1 / 2;
        match is_arm {
            true => image::Rgb([60, 60, 70]),
            false => image::Rgb([120, 110, (100 + row % 60) as u8]),
        }
    })
}

/// A camera and its encoder's eyes.
struct Camera {
    repetition: Repetition,
    stillness: Stillness,
    /// JPEG quality; `None`: raw.
    quality: Option<u8>,
}

impl Camera {
    fn new(quality: Option<u8>) -> Self {
        Self {
            repetition: Repetition::default(),
            stillness: Stillness::new(AFTER, ActionSpace::bridge()),
            quality,
        }
    }

    fn frame(&mut self, stamp_ns: i64, picture: &RgbImage) -> Sight {
        let frame = match self.quality {
            Some(quality) => {
                CameraFrame::Compressed(encode_jpeg(picture, Header::default(), quality).unwrap())
            }
            None => CameraFrame::Raw(encode_image(picture, Header::default())),
        };
        let repeat = self.repetition.frame(stamp_ns, frame.fingerprint());
        let grid = Grid::of(&frame.decode().unwrap());
        self.stillness.frame(stamp_ns, &repeat, Some(&grid))
    }

    /// An action before the next frame.
    fn act(&mut self, dx: f32) {
        self.act_at(0, dx);
    }

    fn act_at(&mut self, stamp_ns: i64, dx: f32) {
        let values = vec![dx, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        self.stillness.action(stamp_ns, values).unwrap();
    }
}

const TRANSPORTS: [Option<u8>; 4] = [None, Some(50), Some(75), Some(95)];

/// The same picture with fresh stamps while the arm moves, with and without noise.
#[test]
fn stopped_camera_is_frozen_until_its_picture_changes() {
    for quality in TRANSPORTS {
        for (rate, noise) in [(5, 0), (30, 0), (5, 1), (30, 1), (5, 3), (10, 2)] {
            for size in [(64, 64), (256, 256), (320, 240)] {
                let (mut camera, mut random) = (Camera::new(quality), Noise(7));
                let what = format!("{quality:?} {rate} Hz, noise {noise}, {size:?}");
                let picture = table(size, 0.3);
                let period = SECOND / rate;
                let mut begun = None;
                for index in 0..3 * rate {
                    camera.act(0.11 / rate as f32);
                    let sight = camera.frame(index * period, &random.on(&picture, noise));
                    if sight.frozen.is_some() {
                        begun.get_or_insert(index * period);
                    }
                    assert_eq!(sight.frozen.is_some(), begun.is_some(), "{what}");
                }
                let begun = begun.expect(&what);
                assert!(
                    (SECOND..=SECOND * 8 / 5).contains(&begun),
                    "{what}: {begun}"
                );
                // The arm stops: that is no sign of a camera that works.
                for index in 3 * rate..5 * rate {
                    camera.act(0.0);
                    let sight = camera.frame(index * period, &random.on(&picture, noise));
                    let text = sight.frozen.expect(&what).to_string();
                    assert!(text.starts_with("the camera has stopped"), "{text}");
                    assert!(sight.change.unwrap() < 1e-4, "{what}");
                    assert!(sight.unchanged_ns >= 2 * SECOND, "{what}");
                }
                let sight = camera.frame(5 * SECOND, &random.on(&table(size, 0.5), noise));
                assert_eq!(sight.frozen, None, "{what}");
                assert!(
                    sight.change.unwrap() > 1e-4 && sight.unchanged_ns == 0,
                    "{what}"
                );
            }
        }
    }
}

#[test]
fn still_arm_before_a_still_scene_is_no_fault() {
    for (rate, noise) in [(5, 1), (30, 2)] {
        let (mut camera, mut random) = (Camera::new(None), Noise(3));
        let picture = table((64, 64), 0.3);
        for index in 0..20 * rate {
            // As a measured pose jitters.
            camera.act(random.next(10) as f32 * 1e-5);
            let sight = camera.frame(index * SECOND / rate, &random.on(&picture, noise));
            assert_eq!(sight.frozen, None, "{index}");
        }
        // The gripper may close on nothing in sight, and a first motion is not late.
        camera.stillness.action(0, vec![0.0; 7]).unwrap();
        camera.act(0.03);
        let sight = camera.frame(20 * SECOND, &random.on(&picture, noise));
        assert_eq!(sight.frozen, None);
    }
}

#[test]
fn live_camera_is_not_frozen_however_slow_the_arm() {
    for quality in TRANSPORTS {
        for speed in [0.005, 0.02, 0.2] {
            let (mut camera, mut random) = (Camera::new(quality), Noise(5));
            let mut x = 0.2;
            for index in 0..50_i64 {
                let dx = (speed / 5.0_f32).min(0.9 - x);
                x += dx;
                camera.act(dx);
                let picture = random.on(&table((256, 256), x), 2);
                let sight = camera.frame(index * SECOND / 5, &picture);
                assert_eq!(sight.frozen, None, "{quality:?} {speed} {index}");
            }
        }
    }
}

/// Pictures that come two seconds after their capture show the motions of then.
#[test]
fn late_pictures_are_compared_with_the_motions_before_them() {
    let (mut camera, mut random) = (Camera::new(None), Noise(4));
    let x = |index: i64| 0.2 + 0.02 * (index - 20).max(0) as f32;
    for index in 10..50_i64 {
        camera.act_at(index * SECOND / 5, x(index + 1) - x(index));
        let seen = index - 10;
        let picture = random.on(&table((256, 256), x(seen)), 1);
        let sight = camera.frame(seen * SECOND / 5, &picture);
        assert_eq!(sight.frozen, None, "{index}");
    }
    for _ in 0..MOST_COMING + 50 {
        camera.act_at(i64::MAX, 0.01);
    }
    assert_eq!(camera.stillness.coming.len(), MOST_COMING);
}

#[test]
fn each_picture_twice_has_half_the_rate_also_with_noise() {
    for noise in [0, 1] {
        let (mut camera, mut random) = (Camera::new(None), Noise(9));
        let mut last = None;
        for index in 0..90_i64 {
            let picture = table((256, 256), 0.1 + 0.01 * (index / 2) as f32);
            let sight = camera.frame(index * SECOND / 30, &random.on(&picture, noise));
            assert_eq!(sight.frozen, None);
            last = Some(sight);
        }
        let sight = last.unwrap();
        assert!(sight.is_repeating);
        assert!((sight.rate.unwrap() - 30.0).abs() < 0.5);
        assert!(
            (sight.distinct_rate.unwrap() - 15.0).abs() < 0.7,
            "{sight:?}"
        );
    }
}

#[test]
fn smooth_motion_repeats_nothing() {
    let (mut camera, mut random) = (Camera::new(None), Noise(2));
    for index in 0..120_i64 {
        let x = 0.2 + 0.0015 * index as f32;
        let sight = camera.frame(index * SECOND / 30, &random.on(&table((320, 240), x), 1));
        assert!(!sight.is_repeating, "{index}");
    }
}

#[test]
fn frozen_after_zero_turns_it_off() {
    let mut camera = Camera::new(None);
    camera.stillness = Stillness::new(Duration::ZERO, ActionSpace::bridge());
    for index in 0..50 {
        camera.act(0.02);
        let sight = camera.frame(index * SECOND / 5, &table((64, 64), 0.3));
        assert_eq!(sight.frozen, None);
        assert_eq!(sight.unchanged_ns, index * SECOND / 5);
    }
}

/// By two transports, or by UDP.
#[test]
fn frozen_camera_stays_frozen_if_its_frames_overtake_each_other() {
    for noise in [0, 1] {
        let (mut camera, mut random) = (Camera::new(None), Noise(6));
        let picture = table((64, 64), 0.3);
        let mut has_begun = false;
        for index in 0..90_i64 {
            camera.act(0.01);
            // 0, 3, 2, 1, 4, 7, 6, 5, and so on.
            let overtaking = [0, 2, 0, -2][(index % 4) as usize];
            let stamp_ns = (index + overtaking) * SECOND / 30;
            let sight = camera.frame(stamp_ns, &random.on(&picture, noise));
            has_begun |= sight.frozen.is_some();
            assert_eq!(sight.frozen.is_some(), has_begun, "{noise} {index}");
            assert_eq!(
                has_begun,
                index > 40 || (has_begun && index > 25),
                "{noise} {index}"
            );
        }
    }
}

#[test]
fn actions_of_another_space_are_refused() {
    let mut stillness = Stillness::new(AFTER, ActionSpace::bridge());
    assert!(stillness.action(0, vec![1.0; 3]).is_err());
    assert!(stillness.action(0, vec![f32::NAN; 7]).is_err());
    assert!(stillness.coming.is_empty());
}

#[test]
fn stamps_that_go_back_begin_anew() {
    let mut camera = Camera::new(None);
    let picture = table((64, 64), 0.3);
    for index in 0..20 {
        camera.frame(100 * SECOND + index * SECOND / 5, &picture);
    }
    let sight = camera.frame(3 * SECOND, &picture);
    assert_eq!((sight.frozen, sight.unchanged_ns), (None, 0));
    assert_eq!(sight.change, None);
}
