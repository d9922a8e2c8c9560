//! Conversion of YUV to RGB, by the colour tags of a video (ITU-T H.273).

use image::RgbImage;
use thiserror::Error;

/// The matrix of luma and colour differences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Matrix {
    /// ITU-R BT.601, ffmpeg's default.
    #[default]
    Bt601,
    /// ITU-R BT.709.
    Bt709,
    /// US Title 47 CFR 73.682.
    Fcc,
    /// SMPTE 240M.
    Smpte240,
    /// ITU-R BT.2020.
    Bt2020,
}

impl Matrix {
    /// The matrix with this number (H.273, table 4); BT.601 for unsupported numbers, as in ffmpeg.
    pub fn of(matrix_coefficients: u8) -> Self {
        match matrix_coefficients {
            1 => Self::Bt709,
            4 => Self::Fcc,
            7 => Self::Smpte240,
            9 | 10 => Self::Bt2020,
            _ => Self::Bt601,
        }
    }

    /// Weights of red and blue.
    fn weights(self) -> (f64, f64) {
        match self {
            Self::Bt601 => (0.299, 0.114),
            Self::Bt709 => (0.2126, 0.0722),
            Self::Fcc => (0.30, 0.11),
            Self::Smpte240 => (0.212, 0.087),
            Self::Bt2020 => (0.2627, 0.0593),
        }
    }
}

/// The colour encoding of a video.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct YuvColours {
    /// The matrix.
    pub matrix: Matrix,
    /// Whether black to white is 0 to 255; otherwise 16 to 235.
    pub is_full_range: bool,
}

/// A plane of samples.
#[derive(Clone, Copy, Debug)]
pub struct Plane<'a> {
    /// The bytes.
    pub data: &'a [u8],
    /// Distance between rows \[bytes\].
    pub stride: usize,
}

impl<'a> Plane<'a> {
    pub(crate) fn row(&self, row: usize, length: usize) -> Option<&'a [u8]> {
        let from = row.checked_mul(self.stride)?;
        self.data.get(from..from.checked_add(length)?)
    }
}

/// A plane is smaller than its picture.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("a plane is smaller than its picture of {width}x{height} pixels")]
pub struct ShortPlane {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Fraction bits of the fixed-point products below.
const FRACTION: u32 = 16;

/// Contributions of each sample value to the colours.
#[derive(Clone, Debug)]
pub struct YuvTable {
    /// Contribution of luma, with a half for rounding.
    luma: [i32; 256],
    red_of_red: [i32; 256],
    green_of_blue: [i32; 256],
    green_of_red: [i32; 256],
    blue_of_blue: [i32; 256],
}

impl YuvTable {
    /// The table of a video's colours.
    pub fn new(colours: YuvColours) -> Self {
        let (red, blue) = colours.matrix.weights();
        let green = 1.0 - red - blue;
        let (black, luma, difference) = match colours.is_full_range {
            true => (0.0, 1.0, 1.0),
            false => (16.0, 255.0 / 219.0, 255.0 / 224.0),
        };
        let scale = f64::from(1_u32 << FRACTION);
        // Fits: products are below 2^10 before scaling.
        let table = |zero: f64, factor: f64| {
            std::array::from_fn(|level| ((level as f64 - zero) * factor * scale).round() as i32)
        };
        let half = 1 << (FRACTION - 1);
        let (of_red, of_blue) = (
            2.0 * (1.0 - red) * difference,
            2.0 * (1.0 - blue) * difference,
        );
        Self {
            luma: table(black, luma).map(|value: i32| value + half),
            red_of_red: table(128.0, of_red),
            green_of_blue: table(128.0, -of_blue * blue / green),
            green_of_red: table(128.0, -of_red * red / green),
            blue_of_blue: table(128.0, of_blue),
        }
    }

    /// The colours of a pixel.
    #[inline]
    pub fn rgb(&self, luma: u8, blue: u8, red: u8) -> [u8; 3] {
        let at = |table: &[i32; 256], level: u8| table[usize::from(level)];
        let (luma, of_blue) = (at(&self.luma, luma), at(&self.green_of_blue, blue));
        [
            luma + at(&self.red_of_red, red),
            luma + of_blue + at(&self.green_of_red, red),
            luma + at(&self.blue_of_blue, blue),
        ]
        .map(|value| (value >> FRACTION).clamp(0, 255) as u8)
    }

    /// Converts three planes, with the colour differences at half resolution in each direction.
    ///
    /// # Errors
    /// A plane is too small.
    pub fn rgb_of_420(
        &self,
        (width, height): (u32, u32),
        [luma, blue, red]: [Plane<'_>; 3],
    ) -> Result<RgbImage, ShortPlane> {
        let short = ShortPlane { width, height };
        let (columns, rows) = (width as usize, height as usize);
        let half = columns.div_ceil(2);
        let mut rgb = Vec::with_capacity(columns * rows * 3);
        for row in 0..rows {
            let luma = luma.row(row, columns).ok_or(short)?;
            let blue = blue.row(row / 2, half).ok_or(short)?;
            let red = red.row(row / 2, half).ok_or(short)?;
            for ((pair, blue), red) in luma.chunks(2).zip(blue).zip(red) {
                for luma in pair {
                    rgb.extend(self.rgb(*luma, *blue, *red));
                }
            }
        }
        RgbImage::from_raw(width, height, rgb).ok_or(short)
    }
}
