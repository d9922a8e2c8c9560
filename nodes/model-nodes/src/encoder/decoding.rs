//! Frames between the topic and the encoder: they are decoded on a thread of their own.

use std::time::Instant;

use image::RgbImage;
use wm_camera::{camera_frame::CameraFrame, image_message::ImageError};
use wm_msgs::std_msgs::Header;
use wm_ros::frame_trace;

use super::{Fate, Grid, Repeat};
use crate::work::Work;

/// Frames that may wait to be decoded, more than those that wait to be encoded: decoding is much faster.
const WAITING: usize = 4;
/// Frames that are not encoded are decoded this often, by their stamps: enough to detect a freeze, and cheap \[ns\].
const DECODE_NS: i64 = 100_000_000;

/// A frame as it was received.
pub(super) struct ReceivedFrame {
    pub frame: CameraFrame,
    pub at: Instant,
    /// The encoder's when it arrived.
    pub epoch: u64,
    pub fate: Fate,
    pub repeat: Repeat,
    is_decoded: bool,
}

/// A frame with its picture.
pub(super) struct DecodedFrame {
    pub header: Header,
    pub is_raw: bool,
    pub at: Instant,
    pub epoch: u64,
    pub fate: Fate,
    pub repeat: Repeat,
    /// `None` for a frame that is not encoded, if another one was decoded just before.
    pub picture: Option<Result<(RgbImage, Grid), ImageError>>,
}

impl ReceivedFrame {
    fn decode(self) -> DecodedFrame {
        let picture = self.is_decoded.then(|| {
            let picture = self.frame.decode()?;
            let grid = Grid::of(&picture);
            Ok((picture, grid))
        });
        let header = self.frame.header().clone();
        frame_trace::passed("picture decoded", header.stamp);
        DecodedFrame {
            is_raw: matches!(self.frame, CameraFrame::Raw(_)),
            header,
            at: self.at,
            epoch: self.epoch,
            fate: self.fate,
            repeat: self.repeat,
            picture,
        }
    }
}

/// Decodes frames, in their order.
pub(super) struct Decoding {
    pub work: Work<ReceivedFrame, DecodedFrame>,
    decoded_ns: Option<i64>,
}

impl Decoding {
    pub fn new() -> Self {
        Self {
            work: Work::new(WAITING, |frame: ReceivedFrame, _| frame.decode()),
            decoded_ns: None,
        }
    }

    /// Takes a frame; returns the oldest waiting one if the queue is full.
    #[must_use = "a frame that is given back is lost: count it"]
    pub fn submit(
        &mut self,
        frame: CameraFrame,
        at: Instant,
        epoch: u64,
        (fate, repeat): (Fate, Repeat),
    ) -> Option<ReceivedFrame> {
        let stamp_ns = frame.header().stamp.to_nanos();
        let is_near =
            |decoded_ns: i64| (0..DECODE_NS).contains(&stamp_ns.saturating_sub(decoded_ns));
        let is_decoded = fate == Fate::Encode || !self.decoded_ns.is_some_and(is_near);
        if is_decoded {
            self.decoded_ns = Some(stamp_ns);
        }
        self.work.submit(ReceivedFrame {
            frame,
            at,
            epoch,
            fate,
            repeat,
            is_decoded,
        })
    }
}
