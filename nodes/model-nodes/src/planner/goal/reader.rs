//! From messages to goals.

use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use wm_camera::{camera_frame::CameraFrame, image_message::decode_image};
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
    pub fn new(encoder: &Arc<Mutex<EncoderStep>>) -> Self {
        Self {
            encoder: Arc::clone(encoder),
            probe: None,
        }
    }

    /// The same, which reads words too, where there is a `probe`.
    #[must_use]
    pub fn with_probe(self, probe: Option<Arc<SuccessClassifier>>) -> Self {
        Self { probe, ..self }
    }

    /// The goal to see what an image shows.
    ///
    /// # Errors
    /// [`GoalError::Picture`].
    pub fn of_picture(&self, frame: &CameraFrame) -> Result<Goal, GoalError> {
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

    /// How many pixels a mask marks in each cell of the latent grid, which covers the whole picture.
    fn mask(&self, mask: &Image) -> Result<Option<Arc<[f32]>>, GoalError> {
        if mask.data.is_empty() {
            return Ok(None);
        }
        let picture = decode_image(mask)?;
        let encoder = self.encoder.lock().unwrap_or_else(PoisonError::into_inner);
        let (rows, columns) = (encoder.space().height, encoder.space().width);
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let mut marked = vec![0_u32; rows * columns];
        for (x, y, pixel) in picture.enumerate_pixels() {
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
    let times: Vec<i64> = message.times.iter().map(|time| time.to_nanos()).collect();
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
