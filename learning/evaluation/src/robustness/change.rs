use std::fmt;

use image::{Rgb, RgbImage, imageops};
use rand::Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};

/// A change of the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Change {
    /// Nothing.
    None,
    /// Half the light.
    Darker,
    /// Half as much light again, clipped.
    Brighter,
    /// Reddish light: the colours' gains are 1.2, 1 and 0.8.
    Warmer,
    /// The picture moved right by a sixteenth of its width; its border is repeated.
    Shifted,
    /// A Gaussian blur of a hundredth of the height.
    Blurred,
    /// Noise of standard deviation 20 of 255.
    Noisy,
    /// The newest frame was lost: the previous one replaces it.
    Dropped,
    /// Frames at half the rate, unknown to the model.
    HalfRate,
    /// Frames at twice the rate, unknown to the model.
    DoubleRate,
}

impl Change {
    /// All changes; the first is none.
    pub const ALL: [Self; 10] = [
        Self::None,
        Self::Darker,
        Self::Brighter,
        Self::Warmer,
        Self::Shifted,
        Self::Blurred,
        Self::Noisy,
        Self::Dropped,
        Self::HalfRate,
        Self::DoubleRate,
    ];

    /// Name in figures.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Darker => "darker",
            Self::Brighter => "brighter",
            Self::Warmer => "warmer",
            Self::Shifted => "shifted",
            Self::Blurred => "blurred",
            Self::Noisy => "noisy",
            Self::Dropped => "dropped",
            Self::HalfRate => "half_rate",
            Self::DoubleRate => "double_rate",
        }
    }

    /// A frame under the change.
    pub(super) fn of(self, frame: &RgbImage, rng: &mut impl Rng) -> RgbImage {
        let gains = |gains: [f32; 3]| {
            let mut changed = frame.clone();
            for Rgb(pixel) in changed.pixels_mut() {
                for (value, gain) in pixel.iter_mut().zip(gains) {
                    *value = byte(f32::from(*value) * gain);
                }
            }
            changed
        };
        match self {
            Self::None | Self::Dropped | Self::HalfRate | Self::DoubleRate => frame.clone(),
            Self::Darker => gains([0.5; 3]),
            Self::Brighter => gains([1.5; 3]),
            Self::Warmer => gains([1.2, 1.0, 0.8]),
            Self::Shifted => {
                let by = frame.width() / 16;
                RgbImage::from_fn(frame.width(), frame.height(), |x, y| {
                    *frame.get_pixel(x.saturating_sub(by), y)
                })
            }
            Self::Blurred => imageops::blur(frame, frame.height() as f32 / 100.0),
            Self::Noisy => {
                let mut changed = frame.clone();
                for Rgb(pixel) in changed.pixels_mut() {
                    for value in pixel {
                        let noise: f32 = StandardNormal.sample(rng);
                        *value = byte(f32::from(*value) + 20.0 * noise);
                    }
                }
                changed
            }
        }
    }

    /// Whether it has an effect for steps of `skip` camera frames: no rate lies between two frames.
    pub(super) fn applies_to(self, skip: usize) -> bool {
        self != Self::DoubleRate || skip > 1
    }

    /// Camera frames per step, when the model assumes `skip`.
    pub(super) fn spacing(self, skip: usize) -> usize {
        match self {
            Self::HalfRate => 2 * skip,
            Self::DoubleRate => (skip / 2).max(1),
            _ => skip,
        }
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::None => "no change",
            Self::Darker => "half the light",
            Self::Brighter => "half as much light again",
            Self::Warmer => "reddish light",
            Self::Shifted => "camera moved by 1/16 of the width",
            Self::Blurred => "blur, sigma 1/100 of the height",
            Self::Noisy => "noise, sigma 20 of 255",
            Self::Dropped => "newest frame lost",
            Self::HalfRate => "frames at half the rate",
            Self::DoubleRate => "frames at twice the rate",
        })
    }
}

/// Rounded and clipped.
fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn every_change_has_a_repeatable_effect() {
        let frame = RgbImage::from_fn(128, 128, |x, y| Rgb([(x * 7) as u8, (y * 5) as u8, 90]));
        let changed = |change: Change| change.of(&frame, &mut ChaCha8Rng::seed_from_u64(3));
        for change in Change::ALL {
            let is_of_pixels =
                !matches!(change, Change::None | Change::Dropped) && change.spacing(2) == 2;
            assert_eq!(changed(change) != frame, is_of_pixels, "{change}");
            assert_eq!(changed(change), changed(change), "{change}");
        }
        assert_eq!(
            changed(Change::Shifted).get_pixel(9, 4),
            frame.get_pixel(1, 4)
        );
        assert_eq!(
            [Change::HalfRate, Change::DoubleRate].map(|c| c.spacing(2)),
            [4, 1]
        );
    }
}
