//! A camera's frame, by either transport.

use std::io::Cursor;

use image::{ImageReader, RgbImage};
use wm_bag::{BagError, BagMessage};
use wm_msgs::{
    Message as _,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::Header,
};

use crate::image_message::{ImageError, decode_compressed, decode_image};

/// A frame by either transport.
#[derive(Clone, Debug)]
pub enum CameraFrame {
    /// sensor_msgs/Image.
    Raw(Image),
    /// sensor_msgs/CompressedImage.
    Compressed(CompressedImage),
}

impl CameraFrame {
    /// The frame that a bag's message holds: compressed if its type says so, else raw.
    ///
    /// # Errors
    /// Bytes that are no message of an image type, by name.
    pub fn of_bag(message: &BagMessage) -> Result<Self, BagError> {
        if message.type_name.as_ref() == CompressedImage::ros_name() {
            message.decode().map(Self::Compressed)
        } else {
            message.decode().map(Self::Raw)
        }
    }

    /// Capture time and optical frame.
    pub fn header(&self) -> &Header {
        match self {
            Self::Raw(image) => &image.header,
            Self::Compressed(image) => &image.header,
        }
    }

    /// Columns and rows, without decoding; none if they cannot be found.
    pub fn size(&self) -> Option<(u32, u32)> {
        match self {
            Self::Raw(image) => Some((image.width, image.height)),
            Self::Compressed(image) => {
                let reader = ImageReader::new(Cursor::new(&image.data));
                reader.with_guessed_format().ok()?.into_dimensions().ok()
            }
        }
    }

    /// The pixels.
    ///
    /// # Errors
    /// [`ImageError`] names what is wrong with the message.
    pub fn decode(&self) -> Result<RgbImage, ImageError> {
        match self {
            Self::Raw(image) => decode_image(image),
            Self::Compressed(image) => decode_compressed(image),
        }
    }
}
