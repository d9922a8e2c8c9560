//! One of the cameras: which of its frames are matched with those of the others, and whether it has stopped.

use std::time::Duration;

use thiserror::Error;
use wm_camera::camera_frame::CameraFrame;
use wm_motion::actions::ActionError;
use wm_msgs::builtin_interfaces::Time;

use crate::{
    camera::{Admission, Camera, Source, WrongCamera},
    encoder::{Arrival, FreezeReason, Grid, Repeat, Repeats, Repetition, Stillness},
    history::{HistoryError, Reception, seconds, stamp_of_frame},
};

/// A camera that is silent for longer may be replaced by another. A restart of its driver takes about as long.
const SILENCE: Duration = Duration::from_secs(1);

/// Why a frame of a camera is dropped before it is matched.
#[derive(Clone, Debug, Error, PartialEq)]
pub(super) enum Refusal {
    #[error(transparent)]
    Camera(#[from] WrongCamera),
    #[error(transparent)]
    Stamp(#[from] HistoryError),
    #[error("the frame of {} arrived twice", seconds(*stamp))]
    Duplicate { stamp: Time },
}

impl Refusal {
    /// The name under which `/diagnostics` counts it.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Camera(_) => WrongCamera::REASON,
            Self::Stamp(error) => error.reason(),
            Self::Duplicate { .. } => "duplicate",
        }
    }
}

/// The kind of an admitted frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Admitted {
    /// A frame to match.
    Frame {
        /// Its stamp \[ns\].
        stamp_ns: i64,
        /// From its capture to its receipt; `None` before the clock is known.
        lag: Option<Duration>,
        /// How its picture compares with the last ones.
        repeat: Repeat,
        /// Whether another camera has taken over with it.
        is_taken_over: bool,
    },
    /// The other transport's copy of a frame.
    Copy,
}

/// A camera.
pub(super) struct CameraView {
    topic: String,
    camera: Option<Camera>,
    repeats: Repeats,
    repetition: Repetition,
    stillness: Stillness,
}

impl CameraView {
    /// The camera of an absolute topic.
    pub fn new(topic: &str, stillness: Stillness) -> Self {
        Self {
            topic: topic.to_owned(),
            camera: None,
            repeats: Repeats::default(),
            repetition: Repetition::default(),
            stillness,
        }
    }

    /// Its topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// Its optical frame; empty if no frame has named it.
    pub fn frame_id(&self) -> String {
        let camera = self.camera.as_ref();
        camera.map_or_else(String::new, |camera| camera.frame_id().to_string())
    }

    /// Takes a frame.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn admit(
        &mut self,
        frame: &CameraFrame,
        reception: &Reception,
    ) -> Result<Admitted, Refusal> {
        let is_taken_over = self.follow(frame, reception)?;
        let (stamp, is_raw) = (frame.header().stamp, matches!(frame, CameraFrame::Raw(_)));
        let stamp_ns = stamp_of_frame(stamp, reception)?;
        match self.repeats.arrive(stamp, is_raw) {
            Arrival::New => {}
            Arrival::OtherTransport => return Ok(Admitted::Copy),
            Arrival::Duplicate => return Err(Refusal::Duplicate { stamp }),
        }
        // A node that waits for /clock has no time yet.
        let now_ns = Some(reception.stamp.to_nanos()).filter(|now_ns| *now_ns > 0);
        let lag_ns = now_ns.and_then(|now_ns| u64::try_from(now_ns.saturating_sub(stamp_ns)).ok());
        let repeat = self.repetition.frame(stamp_ns, frame.fingerprint());
        Ok(Admitted::Frame {
            stamp_ns,
            lag: lag_ns.map(Duration::from_nanos),
            repeat,
            is_taken_over,
        })
    }

    /// Follows the first camera that publishes on the topic; returns whether another one has taken over.
    fn follow(&mut self, frame: &CameraFrame, reception: &Reception) -> Result<bool, WrongCamera> {
        let frame_id = frame.header().frame_id.as_str();
        let source = match frame {
            CameraFrame::Raw(_) => Source::Raw,
            CameraFrame::Compressed(_) => Source::Compressed,
        };
        let Some(camera) = &mut self.camera else {
            self.camera = Some(Camera::new(frame_id, source, reception));
            return Ok(false);
        };
        let is_taken_over =
            camera.admit(frame_id, source, reception, SILENCE)? == Admission::TakenOver;
        if is_taken_over {
            tracing::info!(
                "{}: following another camera now: \"{frame_id}\"",
                self.topic
            );
            self.repeats = Repeats::default();
            self.restart();
        }
        Ok(is_taken_over)
    }

    /// Records that a frame of this transport could not be used. The other transport may still be good.
    pub fn distrust(&mut self, is_raw: bool) {
        self.repeats.distrust(is_raw);
    }

    /// Takes an action of the arm: if it moves, the picture of a live camera changes.
    ///
    /// # Errors
    /// It is not of the arm's action space.
    pub fn action(&mut self, stamp_ns: i64, values: Vec<f32>) -> Result<(), ActionError> {
        self.stillness.action(stamp_ns, values)
    }

    /// Takes a decoded frame; gives the reason if the camera has stopped.
    pub fn seen(&mut self, stamp_ns: i64, repeat: &Repeat, grid: &Grid) -> Option<FreezeReason> {
        self.stillness.frame(stamp_ns, repeat, Some(grid)).frozen
    }

    /// Starts anew: time has jumped, or another camera has taken over.
    pub fn restart(&mut self) {
        self.repetition.restart();
        self.stillness.restart();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Instant;

    use image::{Rgb, RgbImage};
    use wm_motion::actions::ActionSpace;
    use wm_msgs::{sensor_msgs::Image, std_msgs::Header};
    use wm_ros::PublisherId;

    use super::*;

    const START_NS: i64 = 1_700_000_000_000_000_000;

    fn view() -> CameraView {
        let stillness = Stillness::new(Duration::from_secs(1), ActionSpace::bridge());
        CameraView::new("/front/image_raw", stillness)
    }

    /// A frame of a time \[ms\] whose picture is `content`, and its reception 5 ms later.
    fn frame(at: i64, content: u8) -> (CameraFrame, Reception) {
        let stamp = |ms: i64| Time::from_nanos(START_NS + ms * 1_000_000);
        let frame = CameraFrame::Raw(Image {
            header: Header {
                stamp: stamp(at),
                frame_id: "front".into(),
            },
            data: vec![content],
            ..Image::default()
        });
        let reception = Reception {
            stamp: stamp(at + 5),
            clock_step_ns: 0,
            at: Instant::now(),
            publisher: PublisherId([1; 16]),
        };
        (frame, reception)
    }

    fn admit(view: &mut CameraView, at: i64, content: u8) -> Result<Admitted, Refusal> {
        let (frame, reception) = frame(at, content);
        view.admit(&frame, &reception)
    }

    /// Takes a frame whose picture is `content`, and decodes it.
    fn see(view: &mut CameraView, at: i64, content: u8) -> Option<FreezeReason> {
        let Ok(Admitted::Frame {
            stamp_ns,
            lag,
            repeat,
            is_taken_over: false,
        }) = admit(view, at, content)
        else {
            panic!("the frame of {at} ms is refused");
        };
        assert_eq!(lag, Some(Duration::from_millis(5)));
        let picture = RgbImage::from_pixel(64, 64, Rgb([content; 3]));
        view.seen(stamp_ns, &repeat, &Grid::of(&picture))
    }

    #[test]
    fn camera_is_frozen_until_its_picture_changes() {
        let mut view = view();
        for at in (0..=1000).step_by(100) {
            assert_eq!(see(&mut view, at, 7), None);
        }
        let reason = see(&mut view, 1100, 7).unwrap().to_string();
        assert!(reason.contains("byte for byte, for 1.1 s"), "{reason}");
        assert_eq!(see(&mut view, 1200, 80), None);
    }

    #[test]
    fn camera_that_does_not_see_the_arm_move_is_frozen() {
        let mut view = view();
        let mut reasons = Vec::new();
        for at in (0..4000).step_by(200) {
            let action = vec![0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
            view.action(START_NS + at * 1_000_000, action).unwrap();
            // Sensor noise: other bytes, the same scene.
            reasons.extend(see(&mut view, at, 100 + (at / 200 % 2) as u8));
        }
        let reason = reasons.first().unwrap().to_string();
        assert!(reason.contains("but the arm has moved"), "{reason}");
        assert!(view.action(START_NS, vec![0.0]).is_err());
    }

    #[test]
    fn future_duplicate_and_foreign_frames_are_refused() {
        let mut view = view();
        assert!(admit(&mut view, 0, 1).is_ok());
        assert_eq!(admit(&mut view, 0, 1).unwrap_err().reason(), "duplicate");
        let (early, _) = frame(10_000, 2);
        let (_, now) = frame(100, 2);
        let refusal = view.admit(&early, &now).unwrap_err();
        assert!(matches!(refusal, Refusal::Stamp(_)), "{refusal}");
        let other = Reception {
            publisher: PublisherId([2; 16]),
            ..now
        };
        let (next, _) = frame(100, 3);
        assert_eq!(
            view.admit(&next, &other).unwrap_err().reason(),
            "wrong_frame"
        );
    }

    #[test]
    fn other_transport_of_a_frame_is_a_copy() {
        let mut view = view();
        assert!(admit(&mut view, 0, 1).is_ok());
        let (frame, reception) = frame(0, 1);
        let compressed = CameraFrame::Compressed(wm_msgs::sensor_msgs::CompressedImage {
            header: frame.header().clone(),
            ..Default::default()
        });
        assert_eq!(view.admit(&compressed, &reception), Ok(Admitted::Copy));
    }
}
