//! The pictures of a topic of compressed video.

use std::collections::VecDeque;

use image::RgbImage;
use wm_msgs::std_msgs::Header;

use super::{
    ColourTags, H264Decoder, VideoError, VideoPacket,
    h264::{has_keyframe, has_picture},
};

/// Pictures that a decoder holds back at most (H.264, A.3.1), and as many again: with more, pictures are missing.
const MOST_WAITING: usize = 32;

/// A picture with the header of its packet.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Capture time and optical frame.
    pub header: Header,
    /// The pixels.
    pub picture: RgbImage,
}

/// Decodes the packets of a topic, in their order. It begins with the first keyframe; after damage, with the next one.
#[derive(Debug, Default)]
pub struct VideoStream {
    /// None before a keyframe.
    decoder: Option<H264Decoder>,
    /// Headers of packets whose pictures the decoder still has. Pictures come in the order in which they are shown, which
    /// is that of their stamps.
    waiting: VecDeque<Header>,
    dropped: u64,
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
        if self.decoder.is_none() {
            if !has_keyframe(&packet.data) {
                self.dropped += 1;
                return Ok(Vec::new());
            }
            self.decoder = Some(H264Decoder::new(ColourTags::default())?);
        }
        let Some(decoder) = &mut self.decoder else {
            return Ok(Vec::new());
        };
        // Some encoders send their parameters alone.
        if has_picture(&packet.data) {
            let stamp = |header: &Header| header.stamp.to_nanos();
            let place = self
                .waiting
                .partition_point(|other| stamp(other) <= stamp(&packet.header));
            self.waiting.insert(place, packet.header.clone());
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
            Err(_) => {
                self.restart();
                Ok(Vec::new())
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

    /// Packets without a picture: those before a keyframe, and damaged ones.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    fn restart(&mut self) {
        self.dropped += self.waiting.len() as u64;
        self.waiting.clear();
        self.decoder = None;
    }

    fn shown(&mut self, pictures: Vec<RgbImage>) -> Vec<Shown> {
        let waiting = &mut self.waiting;
        let shown = pictures.into_iter().map_while(|picture| {
            let header = waiting.pop_front()?;
            Some(Shown { header, picture })
        });
        shown.collect()
    }
}
