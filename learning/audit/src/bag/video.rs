//! The pictures of video topics.

use std::{
    collections::BTreeMap,
    hash::{DefaultHasher, Hasher as _},
};

use wm_bag::{BagMessage, BagReader};
use wm_camera::{
    signature::Signature,
    transport::Transport,
    video::{VideoPacket, VideoPicture, VideoStream},
};

use super::BagAudit;
use crate::{Finding, Stamps};

/// Decoders of video topics, by camera index.
pub(super) struct Videos(BTreeMap<usize, VideoStream>);

impl Videos {
    pub fn of(reader: &BagReader, cameras: &[String]) -> Self {
        let is_video = |name: &str| {
            let topic = reader.topic(name);
            topic.is_some_and(|topic| {
                Transport::of(name, &topic.type_name) == Some(Transport::Video)
            })
        };
        let cameras = cameras.iter().enumerate();
        let cameras = cameras.filter(|(_, name)| is_video(name));
        Self(cameras.map(|(at, _)| (at, VideoStream::new())).collect())
    }

    pub fn has(&self, camera: usize) -> bool {
        self.0.contains_key(&camera)
    }
}

impl BagAudit {
    pub(super) fn take_packet(
        &mut self,
        camera: usize,
        message: &BagMessage,
    ) -> Result<(), String> {
        let packet = VideoPacket::of_bag(message).map_err(|error| error.to_string())?;
        let at_ns = packet.header.stamp.to_nanos();
        self.recorded.stamp(camera, Stamps::of_bag(message, at_ns));
        let Some(stream) = self.videos.0.get_mut(&camera) else {
            return Ok(());
        };
        let shown = stream.feed(&packet);
        let shown = shown.map_err(|error| format!("{}: {error}", message.topic))?;
        self.show_all(camera, shown);
        Ok(())
    }

    fn show_all(&mut self, camera: usize, shown: Vec<VideoPicture>) {
        for VideoPicture {
            header, picture, ..
        } in shown
        {
            // For a repeated picture, a codec without coded differences gives the same pixels.
            let mut hasher = DefaultHasher::new();
            hasher.write(picture.as_raw());
            let of_bytes = (hasher.finish(), Some(picture.dimensions()));
            let signature = Some(Signature::of(&picture));
            self.show(camera, header.stamp.to_nanos(), of_bytes, signature);
        }
    }

    /// Adds the remaining pictures; returns the faults of the packets.
    pub(super) fn finish_videos(&mut self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for (camera, mut stream) in std::mem::take(&mut self.videos.0) {
            self.show_all(camera, stream.finish());
            let topic = self.cameras.get(camera).map_or("", String::as_str);
            let dropped = stream.dropped();
            if dropped.before_keyframe > 0 {
                let packets = dropped.before_keyframe;
                let what = format!("{topic}: {packets} packets come before the first keyframe");
                findings.push(Finding::note("frames", what).figure("packets", packets as f64));
            }
            let packets = dropped.damaged + dropped.dependent;
            if packets > 0 {
                let what = format!(
                    "{topic}: {packets} packets have no picture: {} are damaged, {} depend on packets that are damaged or missing \
                     (missing in {} places)",
                    dropped.damaged, dropped.dependent, dropped.gaps
                );
                let finding = Finding::warning("frames", what)
                    .because("an episode ends where pictures are missing")
                    .fix("record on a faster disk or network, and send keyframes more often");
                findings.push(finding.figure("packets", packets as f64));
            }
        }
        findings
    }
}
