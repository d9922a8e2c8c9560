//! The one camera that a node follows.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use thiserror::Error;
use wm_ros::PublisherId;

use crate::reception::Reception;

/// A frame of a different camera.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "frame of camera \"{frame_id}\"{}, but this node follows camera \"{expected}\": run an encoder and a predictor for \
     each camera in a separate namespace (--ros-args -r __ns:=/wm/CAMERA)",
    if *.is_other_publisher { " from another publisher" } else { "" }
)]
pub struct WrongCamera {
    /// Its optical frame.
    frame_id: String,
    /// The followed camera's.
    expected: String,
    /// Whether it came from another publisher on the same topic.
    is_other_publisher: bool,
}

impl WrongCamera {
    /// The name under which `/diagnostics` counts it.
    pub const REASON: &'static str = "wrong_frame";
}

/// The topic of a frame: one camera has one publisher on each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// Raw images.
    Raw,
    /// Compressed images.
    Compressed,
    /// Latents.
    Latents,
}

/// The camera of a node's frames: its optical frame, and its publisher on each topic. Frames of two cameras in one context
/// would mislead the model, so frames of other cameras are refused while this one publishes.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    frame_id: Arc<str>,
    publishers: Vec<(Source, PublisherId)>,
    last: Instant,
}

impl Camera {
    pub fn new(frame_id: &str, source: Source, reception: &Reception) -> Self {
        Self {
            frame_id: frame_id.into(),
            publishers: vec![(source, reception.publisher)],
            last: reception.at,
        }
    }

    /// Its optical frame; empty until the first frame.
    pub fn frame_id(&self) -> &Arc<str> {
        &self.frame_id
    }

    /// Checks whether a frame is from this camera. Another camera may take over after a silence longer than `silence`.
    ///
    /// # Errors
    /// [`WrongCamera`] if this camera is still publishing.
    pub fn admit(
        &mut self,
        frame_id: &str,
        source: Source,
        reception: &Reception,
        silence: Duration,
    ) -> Result<Admission, WrongCamera> {
        let mut publishers = self.publishers.iter();
        let known = publishers.find(|(known, _)| *known == source);
        let is_other_publisher = known.is_some_and(|(_, id)| *id != reception.publisher);
        // A driver may leave it empty in some frames: those of the same publisher are the same camera's.
        let is_same_frame =
            *self.frame_id == *frame_id || frame_id.is_empty() || self.frame_id.is_empty();
        if is_same_frame && !is_other_publisher {
            if self.frame_id.is_empty() {
                self.frame_id = frame_id.into();
            }
            if known.is_none() {
                self.publishers.push((source, reception.publisher));
            }
            self.last = reception.at;
            return Ok(Admission::Same);
        }
        if reception.at.saturating_duration_since(self.last) > silence {
            *self = Self::new(frame_id, source, reception);
            return Ok(Admission::TakenOver);
        }
        Err(WrongCamera {
            frame_id: frame_id.into(),
            expected: self.frame_id.to_string(),
            is_other_publisher,
        })
    }
}

/// The owner of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// The camera's.
    Same,
    /// Another one's, which takes its place.
    TakenOver,
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::builtin_interfaces::Time;

    const SILENCE: Duration = Duration::from_secs(1);

    fn reception(publisher: u8, at: Instant) -> Reception {
        Reception {
            stamp: Time::default(),
            clock_step_ns: 0,
            at,
            publisher: PublisherId([publisher; 16]),
        }
    }

    #[test]
    fn a_camera_has_one_publisher_on_each_topic() {
        let now = Instant::now();
        let mut camera = Camera::new("front", Source::Raw, &reception(1, now));
        let mut admit = |frame_id, source, publisher| {
            camera.admit(frame_id, source, &reception(publisher, now), SILENCE)
        };
        // image_transport's republish node is another process than the camera's driver.
        assert_eq!(admit("front", Source::Compressed, 2), Ok(Admission::Same));
        assert_eq!(admit("front", Source::Raw, 1), Ok(Admission::Same));
        for (frame_id, source, publisher) in [
            ("front", Source::Raw, 3),
            ("front", Source::Compressed, 1),
            ("wrist", Source::Raw, 1),
            ("wrist", Source::Compressed, 2),
        ] {
            let error = admit(frame_id, source, publisher).unwrap_err();
            assert_eq!(error.is_other_publisher, frame_id == "front");
        }
    }

    #[test]
    fn an_empty_frame_id_is_any_frame_of_the_same_publisher() {
        let now = Instant::now();
        for first in ["", "front"] {
            let mut camera = Camera::new(first, Source::Raw, &reception(1, now));
            let mut admit = |frame_id, publisher| {
                camera.admit(frame_id, Source::Raw, &reception(publisher, now), SILENCE)
            };
            for frame_id in ["front", "", "front", ""] {
                assert_eq!(admit(frame_id, 1), Ok(Admission::Same));
            }
            assert!(admit("", 2).is_err(), "another publisher");
            assert!(admit("wrist", 1).is_err(), "another camera");
            assert_eq!(&**camera.frame_id(), "front");
        }
    }

    #[test]
    fn a_silent_camera_is_replaced_on_all_topics() {
        let now = Instant::now();
        let mut camera = Camera::new("front", Source::Raw, &reception(1, now));
        let later = now + 2 * SILENCE;
        let admitted = camera.admit("front", Source::Raw, &reception(3, later), SILENCE);
        assert_eq!(admitted, Ok(Admission::TakenOver));
        let admitted = camera.admit("front", Source::Raw, &reception(1, later), SILENCE);
        assert!(admitted.is_err());
    }
}
