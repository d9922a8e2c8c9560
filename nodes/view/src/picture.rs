//! A picture as clients get it: a short binary header, and the JPEG or PNG as published.

use crate::clip;
use bytes::Bytes;
use thiserror::Error;
use wm_camera::{
    camera_frame::CameraFrame,
    image_message::{ImageError, check_compressed, encode_jpeg},
};

/// What a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub(crate) enum Source {
    /// The camera's frame.
    Camera = 0,
    /// The prediction, k steps after an observation.
    Predicted = 1,
    /// The predicted outcome of a plan.
    Plan = 2,
    /// The predicted outcomes of a policy's candidates, one row per candidate.
    Candidates = 3,
    /// The planner's goal.
    Goal = 4,
    /// The subgoals of a plan side by side, nearest first.
    Subgoals = 5,
}

impl Source {
    pub(crate) const ALL: [Self; 6] = [
        Self::Camera,
        Self::Predicted,
        Self::Plan,
        Self::Candidates,
        Self::Goal,
        Self::Subgoals,
    ];

    /// In addresses and events.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Predicted => "predicted",
            Self::Plan => "plan",
            Self::Candidates => "candidates",
            Self::Goal => "goal",
            Self::Subgoals => "subgoals",
        }
    }

    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|source| source.name() == name)
    }
}

/// The compression of a picture. Browsers show both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Format {
    Jpeg = 0,
    Png = 1,
}

impl Format {
    pub(crate) const fn media_type(self) -> &'static str {
        match self {
            Self::Jpeg => "image/jpeg",
            Self::Png => "image/png",
        }
    }
}

/// Identifies a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Label {
    pub source: Source,
    /// k of a predicted picture; otherwise 0.
    pub step: u8,
    /// The time that it shows \[ns\].
    pub stamp_ns: i64,
    /// The observation that a predicted picture starts from; otherwise equal to `stamp_ns` \[ns\].
    pub observed_ns: i64,
}

impl Label {
    /// A picture that is not a prediction.
    pub(crate) const fn of(source: Source, stamp_ns: i64) -> Self {
        Self {
            source,
            step: 0,
            stamp_ns,
            observed_ns: stamp_ns,
        }
    }
}

/// Why an image message is not a picture for the page.
#[derive(Debug, Error)]
pub(crate) enum PictureError {
    #[error("has {actual} bytes, expected at most {MAX_BYTES}")]
    Size { actual: usize },
    /// An incomplete picture, one that is neither JPEG nor PNG, or a raw image that cannot be encoded.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// Largest picture \[byte\]: an 8K JPEG of good quality.
pub(crate) const MAX_BYTES: usize = 16 << 20;

/// Largest JPEG that is checked in less than about 2 ms \[byte\].
const QUICK_BYTES: usize = 256 << 10;

/// JPEG quality for raw images: artefacts are invisible at this size.
const QUALITY: u8 = 85;

/// Version of the header.
const VERSION: u8 = 1;

/// Bytes of the header: version, source, format, step, then three stamps, little endian.
pub(crate) const HEADER_LEN: usize = 4 + 3 * 8;

/// A picture that can be sent. Clones share the bytes.
#[derive(Clone, Debug)]
pub(crate) struct Picture {
    pub label: Label,
    pub format: Format,
    /// Columns and rows.
    pub size: (u32, u32),
    pub frame_id: String,
    /// Header and data.
    message: Bytes,
}

impl Picture {
    /// Whether conversion takes milliseconds: raw images are encoded, and PNGs are decoded to check that they are
    /// complete.
    pub(crate) fn is_slow(frame: &CameraFrame) -> bool {
        match frame {
            CameraFrame::Raw(_) => true,
            CameraFrame::Compressed(image) => {
                image.data.len() > QUICK_BYTES || !image.data.starts_with(b"\xff\xd8")
            }
        }
    }

    /// Converts an image message that arrived at `received_ns`.
    ///
    /// # Errors
    /// Names the fault of the image.
    pub(crate) fn of(
        frame: &CameraFrame,
        label: Label,
        received_ns: i64,
    ) -> Result<Self, PictureError> {
        let encoded;
        let image = match frame {
            CameraFrame::Compressed(image) => image,
            CameraFrame::Raw(image) => {
                encoded = encode_jpeg(&frame.decode()?, image.header.clone(), QUALITY)?;
                &encoded
            }
        };
        let data = &image.data;
        if data.len() > MAX_BYTES {
            return Err(PictureError::Size { actual: data.len() });
        }
        let (format, size) = check_compressed(image)?;
        let format = match format {
            wm_camera::format::Format::Jpeg => Format::Jpeg,
            wm_camera::format::Format::Png => Format::Png,
        };
        let mut message = Vec::with_capacity(HEADER_LEN + data.len());
        message.extend([VERSION, label.source as u8, format as u8, label.step]);
        for stamp in [label.stamp_ns, label.observed_ns, received_ns] {
            message.extend(stamp.to_le_bytes());
        }
        message.extend(data);
        Ok(Self {
            label,
            format,
            size,
            frame_id: clip::text(&image.header.frame_id, 256),
            message: message.into(),
        })
    }

    /// Header and data.
    pub(crate) fn message(&self) -> Bytes {
        self.message.clone()
    }

    /// The JPEG or PNG alone.
    pub(crate) fn data(&self) -> Bytes {
        self.message.slice(HEADER_LEN..)
    }

    pub(crate) fn len(&self) -> usize {
        self.message.len()
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use image::{Rgb, RgbImage};
    use proptest::prelude::*;
    use wm_camera::image_message::encode_image;
    use wm_msgs::{builtin_interfaces::Time, sensor_msgs::CompressedImage, std_msgs::Header};

    pub(crate) fn header(stamp_ns: i64) -> Header {
        Header {
            stamp: Time::from_nanos(stamp_ns),
            frame_id: "camera".to_owned(),
        }
    }

    /// A small JPEG of one grey level.
    pub(crate) fn jpeg(stamp_ns: i64, level: u8) -> CameraFrame {
        let rgb = RgbImage::from_pixel(16, 16, Rgb([level; 3]));
        CameraFrame::Compressed(encode_jpeg(&rgb, header(stamp_ns), 90).unwrap())
    }

    pub(crate) fn picture(label: Label) -> Picture {
        Picture::of(&jpeg(label.stamp_ns, 100), label, 7).unwrap()
    }

    /// The header as a client reads it.
    fn read(message: &[u8]) -> Option<(u8, u8, u8, u8, [i64; 3])> {
        let (&[version, source, format, step], stamps) = message.split_first_chunk()?;
        let stamp = |index: usize| {
            let bytes = stamps.get(8 * index..)?.first_chunk()?;
            Some(i64::from_le_bytes(*bytes))
        };
        Some((
            version,
            source,
            format,
            step,
            [stamp(0)?, stamp(1)?, stamp(2)?],
        ))
    }

    proptest! {
        #[test]
        fn header_identifies_the_picture(
            index in 0usize..6, step: u8, stamp_ns: i64, observed_ns: i64, received_ns: i64,
        ) {
            let label = Label { source: Source::ALL[index], step, stamp_ns, observed_ns };
            let frame = jpeg(0, 10);
            let picture = Picture::of(&frame, label, received_ns).unwrap();
            let CameraFrame::Compressed(image) = frame else { unreachable!() };
            prop_assert_eq!(&picture.data()[..], &image.data[..]);
            let expected = (1, index as u8, 0, step, [stamp_ns, observed_ns, received_ns]);
            prop_assert_eq!(read(&picture.message()), Some(expected));
            prop_assert_eq!(Source::named(label.source.name()), Some(label.source));
        }
    }

    #[test]
    fn raw_images_become_jpegs_and_invalid_ones_are_refused() {
        let rgb = RgbImage::from_pixel(32, 16, Rgb([200, 20, 20]));
        let label = Label::of(Source::Camera, 5);
        let raw = Picture::of(&CameraFrame::Raw(encode_image(&rgb, header(5))), label, 6).unwrap();
        let back = image::load_from_memory(&raw.data()).unwrap().into_rgb8();
        assert_eq!(back.dimensions(), (32, 16));
        assert!(
            back.get_pixel(9, 9).0[0].abs_diff(200) < 8,
            "{:?}",
            back.get_pixel(9, 9)
        );

        let other = CameraFrame::Compressed(CompressedImage {
            header: header(5),
            format: "16UC1; compressedDepth".to_owned(),
            data: vec![0; 40],
        });
        let error = Picture::of(&other, label, 6).unwrap_err().to_string();
        assert!(error.contains("compressedDepth"), "{error}");
        let CameraFrame::Compressed(whole) = jpeg(5, 9) else {
            unreachable!()
        };
        let cut = CompressedImage {
            data: whole.data[..whole.data.len() - 9].to_vec(),
            ..whole
        };
        let cut = Picture::of(&CameraFrame::Compressed(cut), label, 6);
        assert!(cut.unwrap_err().to_string().contains("incomplete"));
        let mut data = b"\xff\xd8\xff".to_vec();
        data.resize(MAX_BYTES + 1, 0);
        let large = CameraFrame::Compressed(CompressedImage {
            data,
            ..CompressedImage::default()
        });
        assert!(matches!(
            Picture::of(&large, label, 6),
            Err(PictureError::Size { .. })
        ));
    }
}
