//! A camera with noise, latency and lost pictures.

use std::{collections::VecDeque, time::Duration};

use image::RgbImage;
use rand::{Rng as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Random streams of the seed, two for each camera: losses do not depend on the noise, and neither depends on the
/// table. The simulator uses the streams from 0 on.
const FIRST_STREAM: u64 = 1 << 32;

/// The camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// At the side of the arm, as in the recordings.
    Side,
    /// The second camera, in front of the arm.
    Front,
}

impl View {
    /// The optical frame of its pictures.
    pub fn frame_id(self) -> &'static str {
        match self {
            Self::Side => wm_sim::CAMERA_FRAME,
            Self::Front => "front_camera_optical_frame",
        }
    }
}

/// The camera's faults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraSettings {
    /// Standard deviation of each value's noise \[grey level\].
    pub noise: f64,
    /// From a picture's stamp to its publication.
    pub latency: Duration,
    /// Share of pictures that are lost, 0 to 1.
    pub drop: f64,
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Its camera.
    pub view: View,
    /// The time of its capture \[ns\].
    pub stamp_ns: i64,
    /// 256 by 256 pixels.
    pub picture: RgbImage,
}

/// The camera, and the pictures that wait for their latency.
pub(super) struct Camera {
    view: View,
    settings: CameraSettings,
    noise: ChaCha8Rng,
    loss: ChaCha8Rng,
    /// In the order of their capture. Few, since the latency is short.
    waiting: VecDeque<Frame>,
}

impl Camera {
    pub(super) fn new(view: View, settings: CameraSettings, seed: u64) -> Self {
        let first = FIRST_STREAM
            + match view {
                View::Side => 0,
                View::Front => 2,
            };
        let stream = |number| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(number);
            rng
        };
        Self {
            view,
            settings,
            noise: stream(first),
            loss: stream(first + 1),
            waiting: VecDeque::new(),
        }
    }

    /// Takes a picture; returns false if it is lost.
    pub(super) fn take(&mut self, mut picture: RgbImage, stamp_ns: i64) -> bool {
        let is_lost = self.loss.random::<f64>() < self.settings.drop;
        let deviation = self.settings.noise;
        if deviation > 0.0 {
            for value in picture.iter_mut() {
                let noise: f64 = self.noise.sample(StandardNormal);
                // The clamp keeps it within a byte.
                *value = (f64::from(*value) + deviation * noise)
                    .round()
                    .clamp(0.0, 255.0) as u8;
            }
        }
        if !is_lost {
            self.waiting.push_back(Frame {
                view: self.view,
                stamp_ns,
                picture,
            });
        }
        !is_lost
    }

    /// When the next picture arrives \[ns\].
    pub(super) fn next_ns(&self) -> Option<i64> {
        // At most 5 s, by the parameter.
        let latency_ns = i64::try_from(self.settings.latency.as_nanos()).unwrap_or(i64::MAX);
        let first = self.waiting.front()?;
        Some(first.stamp_ns.saturating_add(latency_ns))
    }

    /// Removes and returns the pictures that arrive by `now_ns`.
    pub(super) fn arrived(&mut self, now_ns: i64) -> Vec<Frame> {
        let mut arrived = Vec::new();
        while self.next_ns().is_some_and(|due_ns| due_ns <= now_ns) {
            arrived.extend(self.waiting.pop_front());
        }
        arrived
    }

    /// Drops the pictures that wait for their latency; returns their number.
    pub(super) fn forget(&mut self) -> usize {
        let count = self.waiting.len();
        self.waiting.clear();
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey() -> RgbImage {
        RgbImage::from_pixel(64, 64, image::Rgb([128; 3]))
    }

    #[test]
    fn pictures_arrive_after_the_latency_with_capture_stamps() {
        let settings = CameraSettings {
            latency: Duration::from_nanos(30),
            ..CameraSettings::default()
        };
        let mut camera = Camera::new(View::Side, settings, 1);
        assert_eq!(camera.next_ns(), None);
        assert!(camera.take(grey(), 100) && camera.take(grey(), 120));
        assert_eq!(camera.next_ns(), Some(130));
        assert!(camera.arrived(129).is_empty());
        let stamps: Vec<_> = camera.arrived(150).iter().map(|f| f.stamp_ns).collect();
        assert_eq!(stamps, [100, 120]);
        assert!(camera.take(grey(), 160));
        assert_eq!((camera.forget(), camera.next_ns()), (1, None));
    }

    #[test]
    fn noise_and_loss_have_their_set_strength_and_seed() {
        let settings = CameraSettings {
            noise: 5.0,
            drop: 0.25,
            ..CameraSettings::default()
        };
        let series = |seed| {
            let mut camera = Camera::new(View::Side, settings, seed);
            let taken: Vec<_> = (0..400).map(|at| camera.take(grey(), at)).collect();
            (taken, camera.arrived(400))
        };
        let (taken, frames) = series(1);
        assert!((taken.clone(), frames.clone()) == series(1));
        assert_ne!(taken, series(2).0);
        let lost = taken.iter().filter(|is_shown| !**is_shown).count();
        assert!((60..140).contains(&lost), "{lost} of 400");
        let values = frames[0].picture.as_raw();
        let square: f64 = values.iter().map(|v| (f64::from(*v) - 128.0).powi(2)).sum();
        let deviation = (square / values.len() as f64).sqrt();
        assert!((4.8..5.2).contains(&deviation), "{deviation}");
    }

    #[test]
    fn a_good_camera_shows_every_picture_as_it_is() {
        let mut camera = Camera::new(View::Side, CameraSettings::default(), 1);
        for at in 0..50 {
            assert!(camera.take(grey(), at));
            assert_eq!(camera.arrived(at)[0].picture, grey());
        }
        let settings = CameraSettings {
            drop: 1.0,
            ..CameraSettings::default()
        };
        let mut camera = Camera::new(View::Side, settings, 1);
        assert!((0..50).all(|at| !camera.take(grey(), at)));
    }
}
