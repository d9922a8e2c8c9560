//! Bags for tests of this and dependent crates.
#![allow(clippy::unwrap_used, reason = "a test that cannot write its bag fails")]

mod recorder;

use std::{io::Cursor, path::Path};

use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage};
use wm_bag::{BagWriter, WriterOptions};
use wm_msgs::{
    builtin_interfaces::Time,
    sensor_msgs::CompressedImage,
    std_msgs::Header,
    vision_msgs::{LabelInfo, VisionClass},
    wm_msgs::Action,
};

pub use recorder::{CAMERA, MS, Recorder, START_NS};

/// A bag of frames with these red values, at 5 Hz.
pub fn write_reds(bag: &Path, reds: &[u8]) {
    let mut recorder = Recorder::new(bag);
    for (ms, red) in (0..).step_by(200).zip(reds) {
        recorder.frame(CAMERA, ms, *red);
        recorder.action(ms, 0.01);
    }
    recorder.finish();
}

/// A bag of pictures at 5 Hz, with the motion along x from each to the next.
pub fn write_moves(bag: &Path, frames: impl IntoIterator<Item = (RgbImage, f32)>) {
    let mut recorder = Recorder::new(bag);
    for (ms, (picture, dx)) in (0..).step_by(200).zip(frames) {
        recorder.picture(CAMERA, ms, png(picture.into()));
        recorder.action(ms, dx);
    }
    recorder.finish();
}

pub(crate) const PERIOD_NS: i64 = 200_000_000;

pub(crate) fn png(picture: DynamicImage) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
    bytes.into_inner()
}

pub(crate) fn header(index: i64) -> Header {
    Header {
        stamp: Time::from_nanos(index * PERIOD_NS),
        frame_id: String::new(),
    }
}

/// A bag of frames, each with a mask filled with the frame's number, and the meaning of mask values.
pub fn write_masked(bag: &Path, frames: i64) {
    write_bag(bag, frames, &WHOLE);
}

pub(crate) struct Contents {
    pub(crate) camera: bool,
    pub(crate) actions: bool,
    pub(crate) masks: bool,
}

pub(crate) fn write_bag(dir: &Path, frames: i64, contents: &Contents) {
    let mut writer = BagWriter::create(dir, WriterOptions::default()).unwrap();
    if contents.masks {
        let classes = [
            (1, "gripper"),
            (2, "red ball"),
            (3, "blue box"),
            (256, "too many"),
        ];
        let labels = LabelInfo {
            header: header(0),
            class_map: classes
                .map(|(class_id, name)| VisionClass {
                    class_id,
                    class_name: name.into(),
                })
                .into(),
            threshold: 1.0,
        };
        writer.write("/camera/mask/label_info", &labels, 0).unwrap();
    }
    for index in 0..frames {
        let at = (index * PERIOD_NS) as u64;
        let picture = |picture| CompressedImage {
            header: header(index),
            format: "png".into(),
            data: png(picture),
        };
        if contents.camera {
            let frame = RgbImage::from_pixel(32, 32, Rgb([index as u8 * 10, 20, 30]));
            writer
                .write("/camera/image_raw/compressed", &picture(frame.into()), at)
                .unwrap();
        }
        if contents.masks {
            let mask = GrayImage::from_pixel(32, 32, Luma([index as u8]));
            writer
                .write("/camera/mask/compressed", &picture(mask.into()), at)
                .unwrap();
        }
        // Some data sets have no action for the last frame.
        if contents.actions && index + 1 < frames {
            let action = Action {
                header: header(index),
                values: vec![index as f32 / 8., 0., 0., 0., 0., 0., 1.],
            };
            writer.write("/wm/action", &action, at).unwrap();
        }
    }
    writer.finish().unwrap();
}

pub(crate) const WHOLE: Contents = Contents {
    camera: true,
    actions: true,
    masks: true,
};
