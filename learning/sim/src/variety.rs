//! How much one episode differs from the next.

use nalgebra::Vector3;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// An interval to choose from, evenly.
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

    /// The interval of `largest` to both sides of zero.
    pub const fn around_zero(largest: f64) -> Self {
        Self::new(-largest, largest)
    }

    pub(crate) fn pick(self, rng: &mut ChaCha8Rng) -> f64 {
        rng.random_range(self.low..=self.high)
    }

    pub(crate) fn pick_f32(self, rng: &mut ChaCha8Rng) -> f32 {
        // Colours, angles and lengths: single precision is ample.
        self.pick(rng) as f32
    }
}

/// What varies between episodes, and how much. An episode draws each value from its seed.
///
/// The default is moderate: enough that a model cannot take the room for granted, and so little that one
/// with a few million parameters learns it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variety {
    /// How far the camera is from its usual place along each axis, metres.
    pub camera_shift_m: Span,
    /// How far the point that it looks at is from the usual one, metres: 1 cm turns it by about a degree.
    pub camera_aim_m: Span,
    /// Turn of the camera about its view axis, radians.
    pub camera_roll_rad: Span,
    /// Where the light comes from: horizontal parts of its direction, whose upward part is 1. Usually from
    /// the viewer's side, which the middle of these intervals says.
    pub light_x: Span,
    /// See `light_x`.
    pub light_y: Span,
    /// Strength of the light, 1 as usual.
    pub light_strength: Span,
    /// How warm it is: its green and, to twice the extent, its blue fall short by this share.
    pub light_warmth: Span,
    /// Strength of the light from all around, 1 as usual.
    pub ambient: Span,
    /// Brightness of the table's and the floor's colours, 1 as listed.
    pub room_brightness: Span,
    /// Change of each channel of the table's and the floor's colours, sRGB 0 to 1.
    pub room_tint: Span,
    /// Contrast of the table's pattern, as a share of its brightness; patterns are plain, boards, squares
    /// and clouds.
    pub pattern_contrast: Span,
    /// Size of the pattern, metres.
    pub pattern_size_m: Span,
    /// Share of the tables without a pattern.
    pub plain_share: f64,
    /// Change of each channel of an object's named colour, sRGB 0 to 1: it still deserves its name.
    pub object_tint: Span,
    /// Size of an object, 1 as usual for its shape.
    pub object_size: Span,
    /// Shares of the episodes with one, two, three and four objects; they add up to 1.
    pub object_counts: [f64; 4],
    /// Share of the episodes with a mat, a flat place of a colour of its own, to put things on.
    pub mat_share: f64,
    /// Share of the episodes with a mat that have a second one.
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

    /// How many objects to put on the table.
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
