//! The brightness pattern of the table.

/// The kind of a pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PatternKind {
    /// Uniform.
    Plain,
    /// Parallel boards of different brightness, with dark joints.
    Boards,
    /// Squares in two tones.
    Squares,
    /// Soft spots.
    Clouds,
}

/// A pattern on the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pattern {
    /// The kind.
    pub kind: PatternKind,
    /// Width of a board, side of a square, distance of spots; metres.
    pub size_m: f32,
    /// Largest change of brightness, as a share.
    pub contrast: f32,
    /// Turn on the table, radians.
    pub angle_rad: f32,
    /// Seed of boards and spots.
    pub seed: u32,
}

impl Pattern {
    /// No pattern.
    pub const PLAIN: Self = Self {
        kind: PatternKind::Plain,
        size_m: 1.0,
        contrast: 0.0,
        angle_rad: 0.0,
        seed: 0,
    };

    /// Brightness at a point of the table (metres), about 1.
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let (sin, cos) = self.angle_rad.sin_cos();
        let size = self.size_m.max(1e-3);
        let (u, v) = ((cos * x + sin * y) / size, (cos * y - sin * x) / size);
        let (row, column) = (u.floor(), v.floor());
        let tone = match self.kind {
            PatternKind::Plain => return 1.0,
            PatternKind::Boards => {
                let from_joint = (u - row).min(row + 1.0 - u);
                if from_joint < 0.03 {
                    -1.0
                } else {
                    self.noise(row, 0.0)
                }
            }
            PatternKind::Squares => {
                // Fits: coordinates are small.
                if (row as i32 + column as i32) % 2 == 0 {
                    0.5
                } else {
                    -0.5
                }
            }
            PatternKind::Clouds => {
                let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
                let (across, along) = (smooth(u - row), smooth(v - column));
                let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
                mix(
                    mix(
                        self.noise(row, column),
                        self.noise(row + 1.0, column),
                        across,
                    ),
                    mix(
                        self.noise(row, column + 1.0),
                        self.noise(row + 1.0, column + 1.0),
                        across,
                    ),
                    along,
                )
            }
        };
        1.0 + self.contrast * tone
    }

    /// A fixed value between -1 and 1 for each cell.
    fn noise(&self, row: f32, column: f32) -> f32 {
        let mix = |h: u32| {
            let h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
            let h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
            h ^ (h >> 16)
        };
        // Cells are small whole numbers; negative ones wrap.
        let cell = mix(mix(self.seed ^ (row as i32 as u32)) ^ (column as i32 as u32));
        f32::from((cell & 0xffff) as u16) / 32767.5 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_stay_within_their_contrast() {
        for kind in [
            PatternKind::Plain,
            PatternKind::Boards,
            PatternKind::Squares,
            PatternKind::Clouds,
        ] {
            let pattern = Pattern {
                kind,
                size_m: 0.05,
                contrast: 0.1,
                angle_rad: 0.7,
                seed: 3,
            };
            let values: Vec<f32> = (0..2500)
                .map(|i| pattern.at((i % 50) as f32 * 0.02 - 0.5, (i / 50) as f32 * 0.02 - 0.5))
                .collect();
            assert!(values.iter().all(|v| (0.899..1.101).contains(v)));
            let spread = values.iter().cloned().fold(f32::MIN, f32::max)
                - values.iter().cloned().fold(f32::MAX, f32::min);
            assert_eq!(spread > 0.05, kind != PatternKind::Plain, "{kind:?}");
        }
    }
}
