//! Decodes a topic of compressed video.

use std::collections::VecDeque;

use image::RgbImage;
use wm_msgs::std_msgs::Header;

use super::{
    ColourTags, H264Decoder, VideoError, VideoPacket,
    h264::{has_keyframe, has_picture, nal_units},
};

/// Twice the pictures that a decoder may delay (H.264, A.3.1): beyond it, pictures are missing.
const PENDING_LIMIT: usize = 32;

/// A picture with its packet's header and times.
#[derive(Clone, Debug)]
pub struct VideoPicture {
    /// Capture time and optical frame.
    pub header: Header,
    /// Time of recording, in ns since the epoch. If packets and pictures have different orders (B frames), the packets' times
    /// are assigned to the pictures in ascending order.
    pub log_time_ns: u64,
    /// Time of publication, in ns since the epoch, assigned likewise.
    pub publish_time_ns: u64,
    /// The pixels.
    pub picture: RgbImage,
}

/// Number of packets without a picture, by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DropCounts {
    /// Packets before the first keyframe.
    pub before_keyframe: u64,
    /// Damaged packets.
    pub damaged: u64,
    /// Places where packets are missing.
    pub gaps: u64,
    /// Packets from a damaged or missing one to the next keyframe.
    pub dependent: u64,
}

impl DropCounts {
    /// The number of packets without a picture.
    #[must_use]
    pub fn packets(&self) -> u64 {
        self.before_keyframe + self.damaged + self.dependent
    }
}

/// Decodes the packets of a topic in order, from the first keyframe; after damage, from the next one.
#[derive(Debug, Default)]
pub struct VideoStream {
    /// `None` before a keyframe.
    decoder: Option<H264Decoder>,
    has_begun: bool,
    /// Headers of packets whose pictures are pending. Pictures come in presentation order, which is the order of stamps.
    pending: VecDeque<Header>,
    /// Log and publish times of these packets, in the order of arrival.
    times_ns: VecDeque<(u64, u64)>,
    dropped: DropCounts,
}

impl VideoStream {
    /// A stream before its first packet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Decodes a packet; returns the pictures that are ready.
    ///
    /// # Errors
    /// An unsupported codec or layout. Damage is not an error: [`dropped`](Self::dropped) counts packets without a picture.
    pub fn feed(&mut self, packet: &VideoPacket) -> Result<Vec<VideoPicture>, VideoError> {
        if !packet.is_h264() {
            return Err(VideoError::Codec(packet.codec.chars().take(64).collect()));
        }
        if nal_units(&packet.data).next().is_none() {
            self.dropped.damaged += 1;
            return Ok(Vec::new());
        }
        // Some encoders send parameters in packets of their own.
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
                .pending
                .partition_point(|other| stamp(other) <= stamp(&packet.header));
            self.pending.insert(place, packet.header.clone());
            self.times_ns
                .push_back((packet.log_time_ns, packet.publish_time_ns));
            own_place = Some(place);
        }
        match decoder.feed(&packet.data) {
            Ok(pictures) => {
                let shown = self.shown(pictures);
                if self.pending.len() > PENDING_LIMIT {
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
                    self.pending.remove(place);
                    self.times_ns.pop_back();
                }
                Ok(self.finish_before_damage())
            }
        }
    }

    /// Returns the remaining pictures, and restarts.
    pub fn finish(&mut self) -> Vec<VideoPicture> {
        let pictures = self.drain();
        let shown = self.shown(pictures);
        self.restart();
        shown
    }

    /// Returns delayed pictures before a damaged packet, and restarts.
    fn finish_before_damage(&mut self) -> Vec<VideoPicture> {
        let pictures = self.drain();
        // With another number of pictures, their packets are unknown.
        let shown = match pictures.len() == self.pending.len() {
            true => self.shown(pictures),
            false => Vec::new(),
        };
        self.restart();
        shown
    }

    /// The decoder's remaining pictures: none before a keyframe or after an error, which loses only pictures.
    fn drain(&mut self) -> Vec<RgbImage> {
        let left = self.decoder.as_mut().map(H264Decoder::finish);
        left.and_then(Result::ok).unwrap_or_default()
    }

    /// Counts of packets without a picture so far.
    #[must_use]
    pub fn dropped(&self) -> DropCounts {
        self.dropped
    }

    /// Waits for the next keyframe; pending pictures are lost.
    fn restart(&mut self) {
        self.dropped.damaged += self.pending.len() as u64;
        self.pending.clear();
        self.times_ns.clear();
        self.decoder = None;
    }

    fn shown(&mut self, pictures: Vec<RgbImage>) -> Vec<VideoPicture> {
        let (pending, times_ns) = (&mut self.pending, &mut self.times_ns);
        let shown = pictures.into_iter().map_while(|picture| {
            let (log_time_ns, publish_time_ns) = times_ns.pop_front()?;
            Some(VideoPicture {
                header: pending.pop_front()?,
                log_time_ns,
                publish_time_ns,
                picture,
            })
        });
        shown.collect()
    }
}
