//! From messages to goals.

use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use wm_camera::{camera_frame::CameraFrame, image_message::decode_image};
use wm_model::PictureSize;
use wm_msgs::{sensor_msgs::Image, wm_msgs::Goal as GoalMessage};
use wm_wire::latent_message::decode_latent;
use wm_zoo::success_probe::{Instruction, SuccessClassifier};

use super::{Goal, GoalError, MOST_LATENTS};
use crate::encoder::{EncoderError, EncoderStep};

/// Makes goals of messages: encodes pictures, checks latents, reads words.
#[derive(Clone)]
pub struct GoalReader {
    encoder: Arc<Mutex<EncoderStep>>,
    probe: Option<Arc<SuccessClassifier>>,
}

impl GoalReader {
    /// A reader of pictures and latents of the encoder's space.
    pub fn new(encoder: EncoderStep) -> Self {
        Self {
            encoder: Arc::new(Mutex::new(encoder)),
            probe: None,
        }
    }

    /// The same reader, which also reads words if there is a `probe`.
    #[must_use]
    pub fn with_probe(self, probe: Option<Arc<SuccessClassifier>>) -> Self {
        Self { probe, ..self }
    }

    /// The goal to see what an image shows.
    ///
    /// # Errors
    /// [`GoalError::Picture`].
    pub fn of_picture(&self, frame: &CameraFrame) -> Result<Goal, GoalError> {
        frame.header().stamp.checked_nanos()?;
        let picture = frame.decode().map_err(EncoderError::from);
        let values = picture.and_then(|picture| self.encoded(&picture));
        let values = values.map_err(|source| GoalError::Picture { index: 0, source })?;
        Ok(Goal::of_latent(frame.header().stamp, values))
    }

    /// The goal of a message.
    ///
    /// # Errors
    /// [`GoalError`] says what does not fit.
    pub fn of_message(&self, message: &GoalMessage) -> Result<Goal, GoalError> {
        message.header.stamp.checked_nanos()?;
        let (images, latents) = (message.images.len(), message.latents.len());
        if images > 0 && latents > 0 {
            return Err(GoalError::Both { images, latents });
        }
        let goals = images + latents;
        if goals > MOST_LATENTS {
            return Err(GoalError::TooMany(goals));
        }
        if goals == 0 && message.instruction.trim().is_empty() {
            return Err(GoalError::Empty);
        }
        Ok(Goal {
            stamp: message.header.stamp,
            times_ns: times(message, goals)?,
            mask: self.mask(&message.mask)?,
            instruction: self.instruction(message.instruction.trim())?,
            latents: self.latents(message)?,
        })
    }

    fn latents(&self, message: &GoalMessage) -> Result<Vec<Arc<[f32]>>, GoalError> {
        let of_image = |(index, image): (usize, &Image)| {
            let picture = decode_image(image).map_err(EncoderError::from);
            let values = picture.and_then(|picture| self.encoded(&picture));
            values.map_err(|source| GoalError::Picture { index, source })
        };
        let images = message.images.iter().enumerate().map(of_image);
        let encoder = || self.encoder.lock().unwrap_or_else(PoisonError::into_inner);
        let latents = message.latents.iter().enumerate().map(|(index, latent)| {
            let values = decode_latent(latent, encoder().space());
            let values = values.map_err(|source| GoalError::Latent { index, source })?;
            Ok(Arc::from(values))
        });
        images.chain(latents).collect()
    }

    fn encoded(&self, picture: &RgbImage) -> Result<Arc<[f32]>, EncoderError> {
        let encoder = self.encoder.lock().unwrap_or_else(PoisonError::into_inner);
        let values = encoder.encode_values(picture)?;
        if values.iter().any(|value| !value.is_finite()) {
            let what = "the goal's latent";
            return Err(wm_model::Error::NotFinite { what }.into());
        }
        Ok(Arc::from(values))
    }

    /// The number of pixels that a mask of a camera's picture marks in each cell of the latent grid. Pixels outside the
    /// encoder's picture do not count.
    fn mask(&self, mask: &Image) -> Result<Option<Arc<[f32]>>, GoalError> {
        if mask.data.is_empty() {
            return Ok(None);
        }
        let picture = decode_image(mask)?;
        let encoder = self.encoder.lock().unwrap_or_else(PoisonError::into_inner);
        let (rows, columns) = (encoder.space().height, encoder.space().width);
        let framing = encoder.framing();
        let ((height, width), from) = (framing.size, PictureSize::of(&picture));
        let mut marked = vec![0_u32; rows * columns];
        for (x, y, pixel) in picture.enumerate_pixels() {
            let Some((x, y)) = framing.pixel(from, (x, y))? else {
                continue;
            };
            let (row, column) = (y as usize * rows / height, x as usize * columns / width);
            if let Some(count) = marked.get_mut(row * columns + column) {
                *count += u32::from(pixel.0 != [0; 3]);
            }
        }
        // Their mean becomes 1: only how they compare counts.
        let shares: Arc<[f32]> = marked.into_iter().map(|count| count as f32).collect();
        if shares.iter().all(|share| *share == 0.0) {
            return Err(GoalError::NothingMarked);
        }
        Ok(Some(shares))
    }

    fn instruction(&self, text: &str) -> Result<Option<Arc<Instruction>>, GoalError> {
        if text.is_empty() {
            return Ok(None);
        }
        let probe = self.probe.as_ref().ok_or(GoalError::Words)?;
        Ok(Some(Arc::new(probe.instruction(text)?)))
    }
}

fn times(message: &GoalMessage, goals: usize) -> Result<Vec<i64>, GoalError> {
    let times = message.times.iter().map(|time| time.checked_nanos());
    let times = times.collect::<Result<Vec<i64>, _>>()?;
    let fits = times.is_empty() || times.len() == goals;
    let is_ascending = times.is_sorted() && times.first().is_none_or(|first| *first >= 0);
    if fits && is_ascending {
        return Ok(times);
    }
    Err(GoalError::Times {
        times: times.len(),
        goals,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::indexing_slicing)]

    use candle_core::Tensor;
    use wm_camera::image_message::encode_image;
    use wm_model::{Encoder, Fit, Framing, LatentSpace};
    use wm_msgs::{
        builtin_interfaces::{Duration, Time},
        std_msgs::Header,
        wm_msgs::Latent,
    };
    use wm_wire::latent_message::{LatentDtype, encode_latent};

    use super::*;

    /// The brightness of a picture in each of four quarters.
    struct Quarters(LatentSpace, Fit);

    impl Encoder for Quarters {
        fn space(&self) -> &LatentSpace {
            &self.0
        }

        fn input_size(&self) -> (usize, usize) {
            (8, 8)
        }

        fn framing(&self) -> Framing {
            Framing::new((8, 8), self.1)
        }

        fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
            let quarters = images.reshape(&[1, 2, 4, 2, 4, 3][..])?;
            let bright = quarters.mean(5)?.mean(4)?.mean(2)?;
            Ok(bright.reshape((1, 2, 2, 1))?)
        }
    }

    fn space() -> LatentSpace {
        LatentSpace {
            name: "quarters".into(),
            hash: "02".into(),
            height: 2,
            width: 2,
            channels: 1,
        }
    }

    fn reader() -> GoalReader {
        reader_of(Fit::Stretch)
    }

    fn reader_of(fit: Fit) -> GoalReader {
        let encoder = EncoderStep::new(Box::new(Quarters(space(), fit)), LatentDtype::F32);
        GoalReader::new(encoder)
    }

    fn header() -> Header {
        Header {
            stamp: Time { sec: 7, nanosec: 5 },
            frame_id: "camera".into(),
        }
    }

    /// White where `is_white`, else black; 8x8.
    fn image(is_white: impl Fn(u32, u32) -> bool) -> Image {
        let level = |x, y| if is_white(x, y) { 255 } else { 0 };
        let picture = RgbImage::from_fn(8, 8, |x, y| image::Rgb([level(x, y); 3]));
        encode_image(&picture, header())
    }

    fn latent(values: &[f32]) -> Latent {
        encode_latent(values, &space(), LatentDtype::F32, header()).unwrap()
    }

    fn refused(message: &GoalMessage) -> String {
        reader().of_message(message).unwrap_err().to_string()
    }

    #[test]
    fn pictures_and_latents_come_in_their_order_with_their_times() {
        let pictures = GoalMessage {
            header: header(),
            images: vec![image(|x, _| x < 4), image(|_, y| y >= 4)],
            times: vec![Duration::from_nanos(5), Duration::from_nanos(9)],
            ..GoalMessage::default()
        };
        let goal = reader().of_message(&pictures).unwrap();
        assert_eq!(goal.stamp, header().stamp);
        let latents: Vec<&[f32]> = goal.latents.iter().map(|latent| &**latent).collect();
        assert_eq!(latents, [[1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]);
        assert_eq!(goal.times_ns, [5, 9]);
        assert!(goal.mask.is_none() && goal.instruction.is_none());
        let told = GoalMessage {
            latents: vec![latent(&[0.5; 4])],
            ..GoalMessage::default()
        };
        assert_eq!(*reader().of_message(&told).unwrap().latents[0], [0.5; 4]);
    }

    #[test]
    fn a_mask_of_any_size_counts_its_pixels_in_each_cell() {
        let mut mask = Image {
            height: 4,
            width: 6,
            step: 6,
            encoding: "mono8".into(),
            data: vec![0; 24],
            ..Image::default()
        };
        let masked = |mask: &Image| GoalMessage {
            latents: vec![latent(&[0.0; 4])],
            mask: mask.clone(),
            ..GoalMessage::default()
        };
        assert!(refused(&masked(&mask)).contains("0 everywhere"));
        // One faint pixel in the upper right cell, and the lower left one whole.
        mask.data[5] = 1;
        for row in 2..4 {
            mask.data[row * 6..row * 6 + 3].fill(200);
        }
        let goal = reader().of_message(&masked(&mask)).unwrap();
        assert_eq!(*goal.mask.unwrap(), [0.0, 1.0, 6.0, 0.0]);
        mask.step = 2;
        assert!(refused(&masked(&mask)).starts_with("mask:"));
    }

    #[test]
    fn a_mask_marks_what_the_encoder_sees_of_it() {
        // 16x8: a pixel is marked at the left border, and two in the upper right of the middle.
        let mut mask = Image {
            height: 8,
            width: 16,
            step: 16,
            encoding: "mono8".into(),
            data: vec![0; 128],
            ..Image::default()
        };
        mask.data[0] = 1;
        mask.data[8..10].fill(1);
        let marked = |fit, mask: &Image| {
            let message = GoalMessage {
                latents: vec![latent(&[0.0; 4])],
                mask: mask.clone(),
                ..GoalMessage::default()
            };
            let goal = reader_of(fit).of_message(&message)?;
            Ok::<_, GoalError>(goal.mask.unwrap().to_vec())
        };
        assert_eq!(marked(Fit::Stretch, &mask).unwrap(), [1.0, 2.0, 0.0, 0.0]);
        assert_eq!(marked(Fit::Crop, &mask).unwrap(), [0.0, 2.0, 0.0, 0.0]);
        assert_eq!(marked(Fit::Pad, &mask).unwrap(), [1.0, 2.0, 0.0, 0.0]);
        mask.data[8..10].fill(0);
        let error = marked(Fit::Crop, &mask).unwrap_err().to_string();
        assert!(error.contains("nothing would count"), "{error}");
    }

    #[test]
    fn what_is_no_goal_is_refused_by_what_is_wrong() {
        let good = GoalMessage {
            images: vec![image(|_, _| true)],
            ..GoalMessage::default()
        };
        assert!(refused(&GoalMessage::default()).contains("no images"));
        let both = GoalMessage {
            latents: vec![latent(&[0.0; 4])],
            ..good.clone()
        };
        assert!(refused(&both).contains("1 images and 1 latents"));
        let many = GoalMessage {
            images: vec![Image::default(); MOST_LATENTS + 1],
            ..GoalMessage::default()
        };
        assert!(refused(&many).contains("257"));
        let timed = |times: &[i64]| GoalMessage {
            times: times.iter().map(|ns| Duration::from_nanos(*ns)).collect(),
            ..good.clone()
        };
        assert!(refused(&timed(&[1, 2])).contains("2 times for 1"));
        assert!(refused(&timed(&[-1])).contains("ascending from 0"));
        let broken = GoalMessage {
            images: vec![image(|_, _| true), Image::default()],
            ..GoalMessage::default()
        };
        assert!(refused(&broken).starts_with("picture 1:"));
        let elsewhere = LatentSpace {
            hash: "03".into(),
            ..space()
        };
        let foreign = GoalMessage {
            latents: vec![
                encode_latent(&[0.0; 4], &elsewhere, LatentDtype::F32, header()).unwrap(),
            ],
            ..GoalMessage::default()
        };
        let text = refused(&foreign);
        assert!(
            text.starts_with("latent 0:") && text.contains("03"),
            "{text}"
        );
        let words = GoalMessage {
            instruction: "push the cup".into(),
            ..good
        };
        assert!(refused(&words).contains("success_weight"));
    }
}
