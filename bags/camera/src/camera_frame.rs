//! Camera frames, raw or compressed.

use std::{
    hash::{DefaultHasher, Hasher as _},
    io::Cursor,
};

use image::{ImageReader, RgbImage};
use wm_bag::{BagError, BagMessage};
use wm_msgs::{
    Message as _,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};

use crate::{
    foxglove,
    image_message::{ImageError, decode_compressed, decode_image},
};

/// A frame, raw or compressed.
#[derive(Clone, Debug)]
pub enum CameraFrame {
    /// sensor_msgs/Image.
    Raw(Image),
    /// sensor_msgs/CompressedImage.
    Compressed(CompressedImage),
}

impl CameraFrame {
    /// Decodes a bag's message of a ROS image type, or of Foxglove's in protobuf.
    ///
    /// # Errors
    /// The type is not an image type, or the bytes are invalid.
    pub fn of_bag(message: &BagMessage) -> Result<Self, BagError> {
        match &*message.type_name {
            foxglove::COMPRESSED_IMAGE => foxglove::compressed_image(message).map(Self::Compressed),
            foxglove::RAW_IMAGE => foxglove::raw_image(message).map(Self::Raw),
            name if name == CompressedImage::ros_name() => message.decode().map(Self::Compressed),
            _ => message.decode().map(Self::Raw),
        }
    }

    /// Capture time and optical frame.
    pub fn header(&self) -> &Header {
        match self {
            Self::Raw(image) => &image.header,
            Self::Compressed(image) => &image.header,
        }
    }

    /// A hash of the picture's bytes, without the stamp. Frames of a live camera differ by their sensor noise, so equal
    /// fingerprints mean a repeated picture.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        match self {
            Self::Raw(image) => {
                hasher.write_u32(image.width);
                hasher.write_u32(image.step);
                hasher.write(image.encoding.as_bytes());
                hasher.write(&image.data);
            }
            Self::Compressed(image) => hasher.write(&image.data),
        }
        hasher.finish()
    }

    /// Width and height \[px\], read from the header; `None` if it is invalid.
    pub fn size(&self) -> Option<(u32, u32)> {
        match self {
            Self::Raw(image) => Some((image.width, image.height)),
            Self::Compressed(image) => {
                let reader = ImageReader::new(Cursor::new(&image.data));
                reader.with_guessed_format().ok()?.into_dimensions().ok()
            }
        }
    }

    /// Decodes the pixels.
    ///
    /// # Errors
    /// [`ImageError`] names the fault of the message.
    pub fn decode(&self) -> Result<RgbImage, ImageError> {
        match self {
            Self::Raw(image) => decode_image(image),
            Self::Compressed(image) => decode_compressed(image),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::builtin_interfaces::Time;

    fn raw(sec: i32, width: u32, data: &[u8]) -> CameraFrame {
        CameraFrame::Raw(Image {
            header: Header {
                stamp: Time { sec, nanosec: 0 },
                ..Header::default()
            },
            width,
            data: data.to_vec(),
            ..Image::default()
        })
    }

    #[test]
    fn size_is_known_without_decoding() {
        assert_eq!(raw(1, 2, &[]).size(), Some((2, 0)));
        let mut png = Cursor::new(Vec::new());
        RgbImage::new(7, 5)
            .write_to(&mut png, image::ImageFormat::Png)
            .unwrap();
        let mut compressed = CompressedImage {
            format: "jpeg".into(),
            data: png.into_inner(),
            ..CompressedImage::default()
        };
        // A wrong format does not hide the size.
        assert_eq!(
            CameraFrame::Compressed(compressed.clone()).size(),
            Some((7, 5))
        );
        compressed.data.truncate(6);
        assert_eq!(CameraFrame::Compressed(compressed).size(), None);
    }

    #[test]
    fn fingerprint_depends_on_the_picture_alone() {
        let picture = raw(1, 2, &[1, 2, 3, 4]).fingerprint();
        assert_eq!(picture, raw(2, 2, &[1, 2, 3, 4]).fingerprint());
        assert_ne!(picture, raw(1, 2, &[1, 2, 3, 5]).fingerprint());
        assert_ne!(picture, raw(1, 1, &[1, 2, 3, 4]).fingerprint());
        let jpeg = |data: &[u8]| {
            let data = data.to_vec();
            CameraFrame::Compressed(CompressedImage {
                data,
                ..CompressedImage::default()
            })
        };
        assert_eq!(jpeg(&[7, 8]).fingerprint(), jpeg(&[7, 8]).fingerprint());
        assert_ne!(jpeg(&[7, 8]).fingerprint(), jpeg(&[8, 7]).fingerprint());
    }
}
