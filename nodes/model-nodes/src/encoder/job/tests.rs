#![allow(clippy::unwrap_used)]

use candle_core::Tensor;
use wm_model::{Encoder, Fit, LatentSpace};
use wm_msgs::builtin_interfaces::Time;
use wm_wire::latent_message::{LatentDtype, decode_latent};

use super::*;

const PERIOD: i64 = 200_000_000;

/// The mean colour of a picture of 8x8 pixels, times a factor.
struct Means(LatentSpace, f64);

impl Encoder for Means {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn input_size(&self) -> (usize, usize) {
        (8, 8)
    }

    fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
        let means = images.mean(2)?.mean(1)?.reshape((1, 1, 1, 3))?;
        Ok((means * self.1)?)
    }
}

fn step(hash: &str, factor: f64) -> EncoderStep {
    let space = LatentSpace {
        name: "means".into(),
        hash: hash.into(),
        height: 1,
        width: 1,
        channels: 3,
    };
    EncoderStep::new(Box::new(Means(space, factor)), LatentDtype::F32)
}

/// Contexts of two frames, two camera frames apart.
const NEEDS: Needs = Needs {
    frame_period: Duration::from_nanos(PERIOD as u64),
    frame_skip: 2,
    context_frames: 2,
};

/// The frame `index` of a camera with 32x24 pixels.
fn job(index: i64, received: Instant) -> Job {
    let level = u8::try_from(index).unwrap();
    Job {
        picture: RgbImage::from_fn(32, 24, |x, y| image::Rgb([x as u8, y as u8, level])),
        header: Header {
            stamp: Time::from_nanos(index * PERIOD),
            frame_id: "camera".into(),
        },
        is_raw: true,
        received,
        epoch: 7,
        change: 0.5,
        is_frozen: false,
    }
}

fn stamps(jobs: &[Job]) -> Vec<i64> {
    let stamps = jobs.iter().map(|job| job.header.stamp.to_nanos());
    stamps.map(|stamp_ns| stamp_ns / PERIOD).collect()
}

#[test]
fn another_encoder_encodes_the_pictures_of_a_context_again() {
    let (now, before) = (Instant::now(), step("01", 1.0));
    let recent = RecentPictures::new(&NEEDS, Some(before.framing()));
    for index in 0..10 {
        recent.encode(job(index, now), &before).unwrap();
    }
    let after = step("02", 2.0);
    let jobs = recent.take(7, after.framing(), now);
    assert_eq!(stamps(&jobs), [7, 8, 9], "oldest first");
    for (again, index) in jobs.into_iter().zip(7..) {
        assert_eq!(
            again.picture.dimensions(),
            (8, 8),
            "small pictures are kept"
        );
        let latent = again.latent(&after).unwrap();
        let expected = job(index, now).latent(&after).unwrap();
        assert_eq!(latent, expected, "as from the camera's picture");
        assert_eq!((latent.epoch, latent.change), (7, 0.5));
        let values = decode_latent(&latent, after.space()).unwrap();
        assert!(values.iter().any(|value| *value > 0.0));
    }
    assert!(recent.take(7, after.framing(), now).is_empty());
}

#[test]
fn node_that_stays_with_its_model_keeps_no_pictures() {
    let (now, step) = (Instant::now(), step("01", 1.0));
    let kept = RecentPictures::new(&NEEDS, Some(step.framing()));
    let none = RecentPictures::new(&NEEDS, None);
    for index in 0..3 {
        let latent = none.encode(job(index, now), &step).unwrap();
        assert_eq!(latent, kept.encode(job(index, now), &step).unwrap());
        assert_eq!(latent, job(index, now).latent(&step).unwrap());
    }
    assert!(none.take(7, step.framing(), now).is_empty());
}

#[test]
fn pictures_of_another_time_or_size_are_not_encoded_again() {
    let (now, step) = (Instant::now(), step("01", 1.0));
    let taken = |epoch, framing, age: Duration| {
        let recent = RecentPictures::new(&NEEDS, Some(step.framing()));
        recent.encode(job(1, now), &step).unwrap();
        recent.take(epoch, framing, now + age).len()
    };
    let own = step.framing();
    assert_eq!(taken(7, own, Duration::from_millis(900)), 1);
    assert_eq!(taken(8, own, Duration::ZERO), 0, "time has jumped since");
    assert_eq!(
        taken(7, own, Duration::from_secs(2)),
        0,
        "the camera is silent"
    );
    let crop = Framing::new((8, 8), Fit::Crop);
    assert_eq!(taken(7, crop, Duration::ZERO), 0);

    let recent = RecentPictures::new(&NEEDS, Some(own));
    recent.encode(job(1, now), &step).unwrap();
    let later = Job {
        epoch: 8,
        ..job(2, now)
    };
    recent.encode(later, &step).unwrap();
    assert_eq!(stamps(&recent.take(8, own, now)), [2]);
}

#[test]
fn number_of_kept_pictures_is_bounded() {
    let (now, step) = (Instant::now(), step("01", 1.0));
    let needs = Needs {
        context_frames: 64,
        ..NEEDS
    };
    let recent = RecentPictures::new(&needs, Some(step.framing()));
    for index in 0..100 {
        recent.encode(job(index, now), &step).unwrap();
    }
    assert_eq!(recent.take(7, step.framing(), now).len(), MOST_KEPT);
}
