//! The pictures of a topic of compressed video.

use std::collections::VecDeque;

use image::RgbImage;
use wm_msgs::std_msgs::Header;

use super::{
    ColourTags, H264Decoder, VideoError, VideoPacket,
    h264::{has_keyframe, has_picture, nal_units},
};

/// Pictures that a decoder holds back at most (H.264, A.3.1), and as many again: with more, pictures are missing.
const MOST_WAITING: usize = 32;

/// A picture with the header of its packet.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Capture time and optical frame.
    pub header: Header,
    /// When it was recorded, in ns since the epoch: the time of its packet. If packets come in another order than pictures
    /// (B frames), pictures take the times in their own order, so that they do not go back.
    pub log_time_ns: u64,
    /// When it was published, in ns since the epoch, likewise.
    pub publish_time_ns: u64,
    /// The pixels.
    pub picture: RgbImage,
}

/// Packets without a picture, by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Packets before the first keyframe.
    pub before_keyframe: u64,
    /// Packets that cannot be decoded by themselves.
    pub damaged: u64,
    /// Places where packets are missing.
    pub gaps: u64,
    /// Packets between a damaged or missing one and the next keyframe.
    pub dependent: u64,
}

impl Dropped {
    /// The number of packets without a picture.
    #[must_use]
    pub fn packets(&self) -> u64 {
        self.before_keyframe + self.damaged + self.dependent
    }
}

/// Decodes the packets of a topic, in their order. It begins with the first keyframe; after damage, with the next one.
#[derive(Debug, Default)]
pub struct VideoStream {
    /// `None` before a keyframe.
    decoder: Option<H264Decoder>,
    has_begun: bool,
    /// The headers of the packets whose pictures the decoder still has. Pictures come in the order in which they are shown,
    /// which is that of their stamps.
    waiting: VecDeque<Header>,
    /// Log and publish times of these packets, as they came.
    times_ns: VecDeque<(u64, u64)>,
    dropped: Dropped,
}

impl VideoStream {
    /// A stream that has not begun.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a packet; gives the pictures that are ready.
    ///
    /// # Errors
    /// Another codec than h264, or a layout that is not supported. Damage is no error: packets without a picture are
    /// counted by [`dropped`](Self::dropped).
    pub fn feed(&mut self, packet: &VideoPacket) -> Result<Vec<Shown>, VideoError> {
        if !packet.is_h264() {
            return Err(VideoError::Codec(packet.codec.chars().take(64).collect()));
        }
        if nal_units(&packet.data).next().is_none() {
            self.dropped.damaged += 1;
            return Ok(Vec::new());
        }
        // Some encoders send their parameters alone.
        let is_picture = has_picture(&packet.data);
        if self.decoder.is_none() {
            if !has_keyframe(&packet.data) {
                let count = match self.has_begun {
                    true => &mut self.dropped.dependent,
                    false => &mut self.dropped.before_keyframe,
                };
                *count += u64::from(is_picture);
                return Ok(Vec::new());
            }
            self.decoder = Some(H264Decoder::new(ColourTags::default())?);
            self.has_begun = true;
        }
        let Some(decoder) = &mut self.decoder else {
            return Ok(Vec::new());
        };
        let mut own_place = None;
        if is_picture {
            let stamp = |header: &Header| header.stamp.to_nanos();
            let place = self
                .waiting
                .partition_point(|other| stamp(other) <= stamp(&packet.header));
            self.waiting.insert(place, packet.header.clone());
            self.times_ns
                .push_back((packet.log_time_ns, packet.publish_time_ns));
            own_place = Some(place);
        }
        match decoder.feed(&packet.data) {
            Ok(pictures) => {
                let shown = self.shown(pictures);
                if self.waiting.len() > MOST_WAITING {
                    self.restart();
                }
                Ok(shown)
            }
            Err(error @ VideoError::Layout(_)) => Err(error),
            Err(error) => {
                match error {
                    VideoError::Missing => {
                        self.dropped.gaps += 1;
                        self.dropped.dependent += u64::from(is_picture);
                    }
                    _ => self.dropped.damaged += 1,
                }
                if let Some(place) = own_place {
                    self.waiting.remove(place);
                    self.times_ns.pop_back();
                }
                Ok(self.finish_before_damage())
            }
        }
    }

    /// Gives the pictures that are left; the next packet begins anew.
    pub fn finish(&mut self) -> Vec<Shown> {
        let left = self.decoder.as_mut().map(H264Decoder::finish);
        let pictures = left.and_then(Result::ok).unwrap_or_default();
        let shown = self.shown(pictures);
        self.restart();
        shown
    }

    /// Gives the pictures before a damaged packet, which the decoder may hold back; the next packet begins anew.
    fn finish_before_damage(&mut self) -> Vec<Shown> {
        let left = self.decoder.as_mut().map(H264Decoder::finish);
        let pictures = left.and_then(Result::ok).unwrap_or_default();
        // With any other number it is unknown which picture is of which packet.
        let shown = match pictures.len() == self.waiting.len() {
            true => self.shown(pictures),
            false => Vec::new(),
        };
        self.restart();
        shown
    }

    /// Packets without a picture so far.
    #[must_use]
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Waits for the next keyframe; pictures that the decoder still has are lost.
    fn restart(&mut self) {
        self.dropped.damaged += self.waiting.len() as u64;
        self.waiting.clear();
        self.times_ns.clear();
        self.decoder = None;
    }

    fn shown(&mut self, pictures: Vec<RgbImage>) -> Vec<Shown> {
        let (waiting, times_ns) = (&mut self.waiting, &mut self.times_ns);
        let shown = pictures.into_iter().map_while(|picture| {
            let (log_time_ns, publish_time_ns) = times_ns.pop_front()?;
            Some(Shown {
                header: waiting.pop_front()?,
                log_time_ns,
                publish_time_ns,
                picture,
            })
        });
        shown.collect()
    }
}
