//! One frame of each camera to one picture.

use image::RgbImage;
use thiserror::Error;
use wm_camera::camera_frame::CameraFrame;
use wm_model::Framing;

use crate::encoder::{EncoderError, expect_scene};

/// The frame of a camera that cannot be used.
#[derive(Debug, Error)]
#[error("camera {}: {source}", view + 1)]
pub struct JoinError {
    /// Index of the camera.
    pub view: usize,
    /// The fault.
    pub source: Box<EncoderError>,
}

/// Joins frames to pictures for a model.
#[derive(Clone, Copy, Debug)]
pub struct Joiner {
    framing: Framing,
}

impl Joiner {
    /// A joiner for a model that takes pictures so.
    pub fn new(framing: Framing) -> Self {
        Self { framing }
    }

    /// The pictures of `frames`, one of each camera, side by side at the model's size.
    ///
    /// # Errors
    /// [`JoinError`] names the camera with the fault.
    pub fn join<'a>(
        &self,
        frames: impl IntoIterator<Item = &'a CameraFrame>,
    ) -> Result<RgbImage, JoinError> {
        self.place(&decode(frames)?)
    }

    /// Decoded pictures, one of each camera, side by side at the model's size.
    ///
    /// # Errors
    /// Their number is not that of the model.
    pub(super) fn place(&self, pictures: &[RgbImage]) -> Result<RgbImage, JoinError> {
        let joined = self.framing.join(pictures);
        joined.map_err(|error| JoinError {
            view: 0,
            source: Box::new(error.into()),
        })
    }
}

/// The pictures of `frames`, one of each camera.
///
/// # Errors
/// [`JoinError`] names the camera with the fault.
pub(super) fn decode<'a>(
    frames: impl IntoIterator<Item = &'a CameraFrame>,
) -> Result<Vec<RgbImage>, JoinError> {
    let decode = |(view, frame): (usize, &CameraFrame)| {
        let failed = |source: EncoderError| JoinError {
            view,
            source: Box::new(source),
        };
        let picture = frame.decode().map_err(|error| failed(error.into()))?;
        expect_scene(&picture).map_err(failed)?;
        Ok(picture)
    };
    frames.into_iter().enumerate().map(decode).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use image::Rgb;
    use wm_camera::image_message::{encode_image, encode_jpeg};
    use wm_model::Fit;
    use wm_msgs::std_msgs::Header;

    use super::*;

    fn frame(size: (u32, u32), red: u8) -> CameraFrame {
        let picture = RgbImage::from_pixel(size.0, size.1, Rgb([red, 0, 0]));
        CameraFrame::Raw(encode_image(&picture, Header::default()))
    }

    fn joiner(fit: Fit) -> Joiner {
        Joiner::new(Framing {
            views: 2,
            ..Framing::new((16, 32), fit)
        })
    }

    #[test]
    fn cameras_of_any_size_lie_in_their_order() {
        for fit in Fit::ALL {
            let frames = [frame((64, 48), 10), frame((30, 30), 200)];
            let joined = joiner(fit).join(&frames).unwrap();
            assert_eq!(joined.dimensions(), (32, 16));
            assert_eq!((joined[(8, 8)].0[0], joined[(24, 8)].0[0]), (10, 200));
        }
    }

    #[test]
    fn raw_and_compressed_frames_mix() {
        let picture = RgbImage::from_pixel(32, 32, Rgb([200; 3]));
        let jpeg = encode_jpeg(&picture, Header::default(), 95).unwrap();
        let frames = [frame((32, 32), 10), CameraFrame::Compressed(jpeg)];
        let joined = joiner(Fit::Crop).join(&frames).unwrap();
        assert!(joined[(24, 8)].0[0].abs_diff(200) < 3);
    }

    #[test]
    fn camera_with_the_fault_is_named() {
        let small = [frame((64, 48), 10), frame((4, 4), 200)];
        let error = joiner(Fit::Crop).join(&small).unwrap_err();
        assert_eq!(error.view, 1);
        assert!(error.to_string().starts_with("camera 2: picture of 4x4"));
        let error = joiner(Fit::Crop).join(&small[..1]).unwrap_err();
        assert!(error.to_string().contains("expected 2"), "{error}");
    }
}
