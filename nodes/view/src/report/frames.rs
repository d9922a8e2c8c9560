//! The camera's last frames by stamp, resized to the predicted pictures once their resolution is known.

use image::RgbImage;
use std::collections::BTreeMap;
use std::sync::Arc;
use wm_model::{Fit, Framing};

/// The most frames: more than a horizon of 3.2 s at 30 Hz.
const COUNT_LIMIT: usize = 128;

/// The most bytes: until the resolution of the predictions is known, frames may be large.
const BYTE_LIMIT: usize = 96 << 20;

#[derive(Debug, Default)]
pub(super) struct Frames {
    frames: BTreeMap<i64, Arc<RgbImage>>,
    /// How frames are resized, once known.
    framing: Option<Framing>,
    fit: Fit,
    bytes: usize,
}

impl Frames {
    /// Adds a frame; false if there is one with this stamp.
    pub(crate) fn insert(&mut self, stamp_ns: i64, frame: RgbImage) -> bool {
        if self.frames.contains_key(&stamp_ns) {
            return false;
        }
        let frame = match self.framing {
            Some(framing) => framed(frame, framing),
            None => frame,
        };
        self.bytes += frame.as_raw().len();
        self.frames.insert(stamp_ns, Arc::new(frame));
        while self.frames.len() > COUNT_LIMIT || (self.bytes > BYTE_LIMIT && self.frames.len() > 1)
        {
            if let Some((_, oldest)) = self.frames.pop_first() {
                self.bytes -= oldest.as_raw().len();
            }
        }
        true
    }

    /// Sets the resolution of the predicted pictures, and resizes the frames to it.
    pub(crate) fn set_size(&mut self, picture: &RgbImage) {
        let size = (picture.height() as usize, picture.width() as usize);
        let framing = Framing::new(size, self.fit);
        if self.framing != Some(framing) {
            self.framing = Some(framing);
            let old = std::mem::take(&mut self.frames);
            self.frames = old
                .into_iter()
                .map(|(stamp, frame)| (stamp, Arc::new(framed(frame.as_ref().clone(), framing))))
                .collect();
            self.bytes = self.frames.values().map(|frame| frame.as_raw().len()).sum();
        }
    }

    /// Sets how the model frames another aspect ratio. Drops frames that were resized by another fit.
    pub(crate) fn set_fit(&mut self, fit: Fit) {
        if self.fit == fit {
            return;
        }
        self.fit = fit;
        if self.framing.take().is_some() {
            self.clear();
        }
    }

    /// The frame nearest to a stamp, within the tolerance.
    pub(crate) fn nearest(&self, stamp_ns: i64, tolerance_ns: i64) -> Option<&Arc<RgbImage>> {
        let tolerance_ns = tolerance_ns.max(0);
        let range = stamp_ns.saturating_sub(tolerance_ns)..=stamp_ns.saturating_add(tolerance_ns);
        let nearest = self
            .frames
            .range(range)
            .min_by_key(|(found, _)| found.abs_diff(stamp_ns));
        nearest.map(|(_, frame)| frame)
    }

    /// The newest stamp.
    pub(crate) fn newest_ns(&self) -> Option<i64> {
        self.frames.last_key_value().map(|(stamp_ns, _)| *stamp_ns)
    }

    pub(crate) fn clear(&mut self) {
        self.frames.clear();
        self.bytes = 0;
    }
}

/// The frame as the model receives it. A frame that cannot be resized stays unchanged, so that the comparison names the
/// error.
fn framed(frame: RgbImage, framing: Framing) -> RgbImage {
    if (frame.height() as usize, frame.width() as usize) == framing.size {
        return frame;
    }
    match framing.apply(&frame) {
        Ok(framed) => framed,
        Err(_) => frame,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_frame_within_the_tolerance_is_found() {
        let mut frames = Frames::default();
        for stamp in [100, 200, 300] {
            assert!(frames.insert(
                stamp,
                RgbImage::from_pixel(8, 8, image::Rgb([stamp as u8; 3]))
            ));
        }
        assert!(!frames.insert(200, RgbImage::new(8, 8)));
        assert_eq!(frames.nearest(220, 30).unwrap().get_pixel(0, 0).0[0], 200);
        assert!(frames.nearest(250, 30).is_none());
        frames.set_size(&RgbImage::new(4, 4));
        assert_eq!(frames.nearest(300, 0).unwrap().dimensions(), (4, 4));
    }

    #[test]
    fn memory_is_bounded_by_count_and_by_bytes() {
        let mut frames = Frames::default();
        for stamp in 0..1000 {
            frames.insert(stamp, RgbImage::new(8, 8));
        }
        assert_eq!(
            (frames.frames.len(), frames.newest_ns()),
            (COUNT_LIMIT, Some(999))
        );
        frames.clear();
        for stamp in 0..20 {
            frames.insert(stamp, RgbImage::new(2048, 2048));
        }
        assert_eq!(frames.frames.len(), BYTE_LIMIT / (2048 * 2048 * 3));
    }

    #[test]
    fn frames_are_framed_as_for_the_model() {
        let source = RgbImage::from_fn(16, 9, |x, y| image::Rgb([x as u8 * 10, y as u8 * 10, 0]));
        for fit in Fit::ALL {
            let expected = Framing::new((6, 6), fit).apply(&source).unwrap();
            let mut frames = Frames::default();
            frames.set_fit(fit);
            // before and after the size of the predicted pictures is known
            frames.insert(1, source.clone());
            frames.set_size(&RgbImage::new(6, 6));
            frames.insert(2, source.clone());
            for stamp in [1, 2] {
                assert_eq!(**frames.nearest(stamp, 0).unwrap(), expected, "{fit}");
            }
        }
    }

    #[test]
    fn frames_of_another_fit_are_dropped() {
        let mut frames = Frames::default();
        frames.insert(1, RgbImage::new(16, 9));
        frames.set_fit(Fit::Crop);
        assert_eq!(frames.newest_ns(), Some(1), "it was not resized yet");
        frames.set_size(&RgbImage::new(6, 6));
        frames.set_fit(Fit::Crop);
        assert_eq!(frames.newest_ns(), Some(1));
        frames.set_fit(Fit::Pad);
        assert_eq!((frames.newest_ns(), frames.bytes), (None, 0));
    }
}
