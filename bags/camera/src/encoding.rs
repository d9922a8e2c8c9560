//! The pixel formats of sensor_msgs/Image, by their names in sensor_msgs/image_encodings.hpp.

use crate::error::ImageError;

/// Layout of an image's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    /// Bytes per pixel, and offsets of red, green and blue.
    Pixels { bytes: usize, rgb: [usize; 3] },
    /// Four bytes per two pixels: offsets of the first luma (the second is two bytes later) and of the blue and red
    /// differences.
    Yuv422 {
        luma: usize,
        differences: [usize; 2],
    },
    /// A plane of luma, then a plane with pairs of differences.
    SemiPlanar {
        /// Whether the red difference comes first.
        is_red_first: bool,
        /// Whether the differences have full resolution; otherwise half in each direction.
        is_full_size: bool,
    },
    /// One colour per pixel: column and row of the first red pixel.
    Bayer { red: (usize, usize) },
}

impl Encoding {
    /// The layout of an encoding, by name.
    ///
    /// # Errors
    /// [`ImageError::Depth`], [`ImageError::Encoding`].
    pub(crate) fn of(name: &str) -> Result<Self, ImageError> {
        let pixels = |bytes, rgb| Self::Pixels { bytes, rgb };
        let semi_planar = |is_red_first, is_full_size| Self::SemiPlanar {
            is_red_first,
            is_full_size,
        };
        Ok(match name {
            "rgb8" => pixels(3, [0, 1, 2]),
            // OpenCV's types are in BGR order.
            "bgr8" | "8UC3" => pixels(3, [2, 1, 0]),
            "rgba8" => pixels(4, [0, 1, 2]),
            "bgra8" | "8UC4" => pixels(4, [2, 1, 0]),
            "mono8" | "8UC1" => pixels(1, [0; 3]),
            "yuv422" | "uyvy" => Self::Yuv422 {
                luma: 1,
                differences: [0, 2],
            },
            "yuv422_yuy2" | "yuyv" => Self::Yuv422 {
                luma: 0,
                differences: [1, 3],
            },
            "nv12" => semi_planar(false, false),
            "nv21" => semi_planar(true, false),
            // As in V4L2: blue first.
            "nv24" => semi_planar(false, true),
            "bayer_rggb8" => Self::Bayer { red: (0, 0) },
            "bayer_grbg8" => Self::Bayer { red: (1, 0) },
            "bayer_gbrg8" => Self::Bayer { red: (0, 1) },
            "bayer_bggr8" => Self::Bayer { red: (1, 1) },
            "mono16" | "16UC1" | "16SC1" | "32FC1" | "32SC1" | "64FC1" => {
                return Err(ImageError::Depth(name.to_owned()));
            }
            _ => return Err(ImageError::Encoding(name.to_owned())),
        })
    }

    /// Size of a row \[bytes\].
    pub(crate) fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Pixels { bytes, .. } => width * bytes,
            Self::Yuv422 { .. } => width.div_ceil(2) * 4,
            Self::SemiPlanar { .. } | Self::Bayer { .. } => width,
        }
    }
}
