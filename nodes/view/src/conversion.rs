//! Encodes raw images on other threads, in order of arrival.

use crate::picture::{Label, Picture, PictureError, Source};
use futures::{StreamExt as _, stream::FuturesOrdered};
use std::collections::BTreeMap;
use tokio::task::JoinHandle;
use wm_camera::camera_frame::CameraFrame;

/// A picture or its error, and the image's arrival \[ns\].
pub(crate) type Conversion = (Label, i64, Result<Picture, PictureError>);

/// Images being encoded.
#[derive(Default)]
pub(crate) struct Conversions {
    running: FuturesOrdered<JoinHandle<Conversion>>,
    waiting: BTreeMap<Source, usize>,
}

/// The most images per source: of a camera the next one is as good, but a rollout's predictions arrive together.
const fn limit(source: Source) -> usize {
    match source {
        Source::Predicted => 64,
        _ => 2,
    }
}

impl Conversions {
    /// Starts encoding an image; false if too many are being encoded.
    pub(crate) fn begin(&mut self, frame: CameraFrame, label: Label, now_ns: i64) -> bool {
        let waiting = self.waiting.entry(label.source).or_default();
        if *waiting >= limit(label.source) {
            return false;
        }
        *waiting += 1;
        let convert = move || (label, now_ns, Picture::of(&frame, label, now_ns));
        self.running.push_back(tokio::task::spawn_blocking(convert));
        true
    }

    /// The next picture; waits forever if there are no images. Cancel safe.
    pub(crate) async fn next(&mut self) -> Option<Conversion> {
        let Some(converted) = self.running.next().await else {
            return std::future::pending().await;
        };
        // encoding does not panic; if it did, its source would lose one place
        let converted = converted.ok()?;
        if let Some(waiting) = self.waiting.get_mut(&converted.0.source) {
            *waiting -= 1;
        }
        Some(converted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::tests::header;
    use image::RgbImage;
    use wm_camera::image_message::encode_image;

    #[tokio::test]
    async fn images_are_encoded_in_order_up_to_a_limit() {
        let mut conversions = Conversions::default();
        let rgb = RgbImage::new(64, 48);
        let frame = CameraFrame::Raw(encode_image(&rgb, header(1)));
        let begun: Vec<bool> = (0..4)
            .map(|stamp| conversions.begin(frame.clone(), Label::of(Source::Camera, stamp), stamp))
            .collect();
        assert_eq!(begun, [true, true, false, false]);
        for stamp in 0..2 {
            let (label, now_ns, picture) = conversions.next().await.unwrap();
            assert_eq!((label.stamp_ns, now_ns), (stamp, stamp));
            assert!(picture.is_ok());
        }
        assert!(conversions.begin(frame, Label::of(Source::Camera, 9), 9));
    }
}
