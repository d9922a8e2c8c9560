//! Variation between episodes.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// An interval with a uniform distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Lowest value.
    pub low: f64,
    /// Highest value; at least `low`.
    pub high: f64,
}

impl Span {
    /// The interval between two values, in either order.
    pub const fn new(a: f64, b: f64) -> Self {
        if a < b {
            Self { low: a, high: b }
        } else {
            Self { low: b, high: a }
        }
    }

    /// The interval from `-largest` to `largest`.
    pub const fn around_zero(largest: f64) -> Self {
        Self::new(-largest, largest)
    }

    pub(crate) fn pick(self, rng: &mut ChaCha8Rng) -> f64 {
        rng.random_range(self.low..=self.high)
    }

    pub(crate) fn pick_f32(self, rng: &mut ChaCha8Rng) -> f32 {
        // Single precision suffices for colours, angles and lengths.
        self.pick(rng) as f32
    }
}

/// The variation between episodes. Each episode draws its values from its seed.
///
/// The default is moderate: a model cannot ignore the room, but one with a few million parameters can learn it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variety {
    /// Offset of the camera from its usual place along each axis, metres.
    pub camera_shift_m: Span,
    /// Offset of the camera's target point, metres: 1 cm turns the camera by about a degree.
    pub camera_aim_m: Span,
    /// Turn of the camera about its view axis, radians.
    pub camera_roll_rad: Span,
    /// Horizontal x of the direction towards the light, whose upward part is 1. The middle of the intervals is on the viewer's
    /// side.
    pub light_x: Span,
    /// Horizontal y, see `light_x`.
    pub light_y: Span,
    /// Strength of the light, usually 1.
    pub light_strength: Span,
    /// Warmth of the light: reduction of green by this share, and of blue by twice as much.
    pub light_warmth: Span,
    /// Strength of the ambient light, usually 1.
    pub ambient: Span,
    /// Brightness factor of the table's and the floor's colours.
    pub room_brightness: Span,
    /// Change of each channel of the table's and the floor's colours, sRGB 0 to 1.
    pub room_tint: Span,
    /// Contrast of the table's pattern, as a share of its brightness.
    pub pattern_contrast: Span,
    /// Size of the pattern, metres.
    pub pattern_size_m: Span,
    /// Share of tables without a pattern.
    pub plain_share: f64,
    /// Change of each channel of an object's named colour, sRGB 0 to 1: small enough for its name.
    pub object_tint: Span,
    /// Size factor of an object, usually 1.
    pub object_size: Span,
    /// Shares of episodes with one, two, three and four objects; their sum is 1.
    pub object_counts: [f64; 4],
    /// Share of episodes with a mat, a flat coloured place for objects.
    pub mat_share: f64,
    /// Share of these with a second mat.
    pub second_mat_share: f64,
}

impl Default for Variety {
    fn default() -> Self {
        Self {
            camera_shift_m: Span::around_zero(0.02),
            camera_aim_m: Span::around_zero(0.012),
            camera_roll_rad: Span::around_zero(0.035),
            light_x: Span::new(-0.25, 0.45),
            light_y: Span::new(-0.55, 0.05),
            light_strength: Span::new(0.82, 1.12),
            light_warmth: Span::new(0.0, 0.07),
            ambient: Span::new(0.85, 1.2),
            room_brightness: Span::new(0.82, 1.08),
            room_tint: Span::around_zero(0.03),
            pattern_contrast: Span::new(0.04, 0.16),
            pattern_size_m: Span::new(0.03, 0.09),
            plain_share: 0.3,
            object_tint: Span::around_zero(0.04),
            object_size: Span::new(0.9, 1.15),
            object_counts: [0.1, 0.55, 0.3, 0.05],
            mat_share: 0.55,
            second_mat_share: 0.35,
        }
    }
}

impl Variety {
    pub(crate) fn vector(span: Span, rng: &mut ChaCha8Rng) -> Vector3<f32> {
        Vector3::from_fn(|_, _| span.pick_f32(rng))
    }

    /// Draws the number of objects.
    pub(crate) fn object_count(&self, rng: &mut ChaCha8Rng) -> usize {
        let mut left = rng.random_range(0.0..1.0);
        for (index, share) in self.object_counts.into_iter().enumerate() {
            left -= share;
            if left < 0.0 {
                return index + 1;
            }
        }
        self.object_counts.len()
    }
}
