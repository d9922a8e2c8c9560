//! What to reach.

use std::sync::{Arc, Mutex, PoisonError};

use wm_msgs::builtin_interfaces::Time;

use crate::{
    encoder::{EncoderError, EncoderStep},
    pool::Pool,
    work::Work,
};
use wm_camera::camera_frame::CameraFrame;

/// The goal: an image's latent.
#[derive(Clone, Debug, PartialEq)]
pub struct Goal {
    /// The image's stamp.
    pub stamp: Time,
    /// Its normalised latent, row-major, channels last.
    pub values: Arc<[f32]>,
}

impl Goal {
    /// The goal that an image shows.
    ///
    /// # Errors
    /// An image that is none, or one of which the model makes no finite latent.
    pub fn of(frame: &CameraFrame, encoder: &EncoderStep) -> Result<Self, EncoderError> {
        let values = encoder.encode_values(&frame.decode()?)?;
        if values.iter().any(|value| !value.is_finite()) {
            return Err(wm_model::Error::NotFinite {
                what: "the goal's latent",
            }
            .into());
        }
        Ok(Self {
            stamp: frame.header().stamp,
            values: Arc::from(values),
        })
    }

    /// Makes goals of images; the newest is enough: one may wait.
    pub(crate) fn work(
        encoder: &Arc<Mutex<EncoderStep>>,
        pool: &Pool,
    ) -> Work<CameraFrame, Result<Self, EncoderError>> {
        let encoder = Arc::clone(encoder);
        Work::new(1, move |frame: CameraFrame, _| {
            let encoder = encoder.lock().unwrap_or_else(PoisonError::into_inner);
            Self::of(&frame, &encoder)
        })
        .on(pool)
    }
}
