#![allow(clippy::unwrap_used)]

use super::*;
use crate::Level;
use image::{Rgb, RgbImage};
use std::{collections::BTreeMap, io::Cursor};
use tempfile::TempDir;
use wm_bag::{BagWriter, WriterOptions};
use wm_msgs::{
    builtin_interfaces::Time,
    geometry_msgs::{Point, Pose, Quaternion},
    sensor_msgs::CompressedImage,
    std_msgs::Header,
};

const START: i64 = 1_750_000_000_000_000_000;

/// The differences of a recording from a good one.
struct Case {
    frames: i64,
    rate: i64,
    /// The moment of the motion that frame `k` shows.
    shown: fn(i64) -> i64,
    size: fn(i64) -> (u32, u32),
    camera_stamp: fn(i64) -> i64,
    action_stamp: fn(i64) -> i64,
    action: fn(i64) -> [f32; 3],
    /// Change of the state along z for one metre of action.
    z_factor: f64,
}

const GOOD: Case = Case {
    frames: 80,
    rate: 5,
    shown: |k| k,
    size: |_| (64, 48),
    camera_stamp: |at| at,
    action_stamp: |at| at,
    action: moves,
    z_factor: 1.0,
};

/// Position of the arm at a frame \[m\].
fn place(frame: i64) -> [f64; 3] {
    let t = frame as f64;
    let x = (0.9 * t + 1.3 * (0.37 * t).sin()).sin() * 0.05;
    [x, 0.03 * (0.5 * t).sin(), 0.03 * (0.35 * t).cos()]
}

/// Motion from a frame to the next.
fn moves(frame: i64) -> [f32; 3] {
    let (here, next) = (place(frame), place(frame + 1));
    [0, 1, 2].map(|axis: usize| (next[axis] - here[axis]) as f32)
}

fn picture(frame: i64, (width, height): (u32, u32)) -> Vec<u8> {
    let [x, y, z] = place(frame.max(0));
    let left = (24.0 + 300.0 * x) as i64;
    let top = (18.0 + 200.0 * (y + z)) as i64;
    let shown = RgbImage::from_fn(width, height, |column, row| {
        let (column, row) = (i64::from(column), i64::from(row));
        let is_inside = (left..left + 12).contains(&column) && (top..top + 12).contains(&row);
        Rgb(if is_inside { [250, 120, 20] } else { [60; 3] })
    });
    let mut bytes = Cursor::new(Vec::new());
    shown.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn header(stamp_ns: i64) -> Header {
    Header {
        stamp: Time::from_nanos(stamp_ns),
        frame_id: "camera".into(),
    }
}

fn audit(case: &Case) -> Audit {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    let mut z = 0.2;
    for k in 0..case.frames {
        let at_ns = START + k * 1_000_000_000 / case.rate;
        let log_ns = u64::try_from(at_ns).unwrap();
        let image = CompressedImage {
            header: header((case.camera_stamp)(at_ns)),
            format: "png".into(),
            data: picture((case.shown)(k), (case.size)(k)),
        };
        writer
            .write("/camera/image_raw/compressed", &image, log_ns)
            .unwrap();
        let [dx, dy, dz] = (case.action)(k);
        let action = Action {
            header: header((case.action_stamp)(at_ns)),
            values: vec![dx, dy, dz, 0.0, 0.0, 0.0, 1.0],
        };
        writer.write("/wm/action", &action, log_ns).unwrap();
        let [x, y, _] = place(k);
        let pose = PoseStamped {
            header: header((case.action_stamp)(at_ns)),
            pose: Pose {
                position: Point { x, y, z },
                orientation: Quaternion {
                    x: 0.0,
                    y: 0.0,
                    z: 0.0,
                    w: 1.0,
                },
            },
        };
        writer
            .write("/arm/end_effector_pose", &pose, log_ns)
            .unwrap();
        z += case.z_factor * f64::from(dz);
    }
    writer.finish().unwrap();
    audit_bag(&BagReader::open(&bag).unwrap(), &Topics::default(), || ())
}

/// Check and level of each finding above a note.
fn faults(case: &Case) -> BTreeMap<String, Level> {
    let audit = audit(case);
    audit
        .faults()
        .map(|finding| (finding.check.to_string(), finding.level))
        .collect()
}

fn only(check: &str, level: Level) -> BTreeMap<String, Level> {
    [(check.to_owned(), level)].into()
}

/// The cameras of a bag with these topics of sensor_msgs/CompressedImage.
fn cameras_of(topics: &[&str]) -> (Vec<String>, Vec<Finding>) {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    for topic in topics {
        let image = CompressedImage::default();
        writer.write(topic, &image, 1).unwrap();
    }
    writer.finish().unwrap();
    let mut findings = Vec::new();
    let cameras = select_cameras(&BagReader::open(&bag).unwrap(), &[], false, &mut findings);
    (cameras, findings)
}

#[test]
fn topics_of_other_codecs_are_not_cameras() {
    let (zstd, depth) = ("/camera/image_raw/zstd", "/camera/depth/compressedDepth");
    let (found, findings) = cameras_of(&[depth, "/camera/image_raw/compressed", zstd]);
    assert_eq!(found, ["/camera/image_raw/compressed"]);
    assert_eq!(findings, []);
    let (found, findings) = cameras_of(&[zstd]);
    assert!(found.is_empty());
    assert_eq!(findings[0].level, Level::Error);
    assert!(findings[0].fix.as_deref().unwrap().contains("zstd"));
}

#[test]
fn video_without_decoder_is_named() {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    let schema = wm_bag::Schema::ros2msg("uint8[] data");
    for topic in ["/front/ffmpeg", "/wrist/image_raw/h264"] {
        let name = "foxglove_msgs/msg/CompressedVideo";
        writer
            .write_raw(topic, name, &schema, 1, &[0, 1, 0, 0])
            .unwrap();
    }
    let image = CompressedImage::default();
    writer
        .write("/wrist/image_raw/compressed", &image, 1)
        .unwrap();
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    assert_eq!(video_topics(&reader), ["/front/ffmpeg"]);
    for named in [vec![], vec!["/front/ffmpeg".to_owned()]] {
        let mut findings = Vec::new();
        let found = select_cameras(&reader, &named, false, &mut findings);
        assert_eq!(found.len(), 1 - named.len());
        let [finding] = findings.as_slice() else {
            panic!("{findings:?}");
        };
        assert_eq!(finding.level, Level::Note);
        let expected = "not judged: /front/ffmpeg is compressed video";
        assert!(finding.what.contains(expected), "{finding:?}");
    }
}

#[test]
fn good_recording_has_no_finding() {
    let audit = audit(&GOOD);
    let found: Vec<_> = audit
        .findings
        .iter()
        .filter(|f| f.level > Level::Ok)
        .collect();
    assert!(found.is_empty(), "{audit}");
    let text = audit.to_string();
    for expected in [
        "64x48, 80 pictures at 5.0 Hz",
        "of the same moment",
        "the state changes as the actions say",
    ] {
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn camera_slower_than_its_actions_is_found() {
    let slow = Case { rate: 4, ..GOOD };
    let audit = audit(&slow);
    let found = audit
        .faults()
        .find(|finding| finding.check == "rate")
        .unwrap();
    assert!(found.what.contains("4.0 frames per second"), "{found}");
    assert_eq!(found.figures["camera_hz"], 4.0);
}

#[test]
fn each_picture_fault_has_its_finding() {
    let repeats = |k: i64| if k % 5 == 1 || k % 5 == 3 { k - 1 } else { k };
    assert_eq!(
        faults(&Case {
            shown: repeats,
            ..GOOD
        }),
        only("repeats", Level::Warning)
    );
    let frozen = faults(&Case {
        shown: |_| 3,
        ..GOOD
    });
    assert_eq!(frozen, only("frozen", Level::Error));
    let sizes = Case {
        size: |k| if k < 40 { (64, 48) } else { (96, 48) },
        ..GOOD
    };
    assert_eq!(faults(&sizes), only("sizes", Level::Warning));
}

#[test]
fn camera_published_at_twice_its_rate_gets_true_rate() {
    let twice = Case {
        rate: 10,
        frames: 120,
        shown: |k| k / 2,
        ..GOOD
    };
    let audit = audit(&twice);
    let finding = audit
        .faults()
        .find(|finding| finding.check == "repeats")
        .unwrap();
    assert!(
        finding.what.contains("10.0 Hz come, 5.0 Hz differ"),
        "{}",
        finding.what
    );
}

#[test]
fn late_pictures_are_found_with_their_shift() {
    let audit = audit(&Case {
        shown: |k| k - 2,
        ..GOOD
    });
    let lag = audit.faults().find(|finding| finding.check == "lag");
    let lag = lag.unwrap_or_else(|| panic!("{audit}"));
    assert_eq!(lag.figures["lag_frames"], 2.0);
}

#[test]
fn each_stamp_fault_has_its_finding() {
    let error = only("stamps", Level::Error);
    for camera_stamp in [
        |_| 0,
        |_| START,
        |at| at - START + 100_000_000_000,
        |at| at - 170_000_000_000,
    ] as [fn(i64) -> i64; 4]
    {
        assert_eq!(
            faults(&Case {
                camera_stamp,
                ..GOOD
            }),
            error
        );
    }
    assert_eq!(
        faults(&Case {
            camera_stamp: |_| 0,
            action_stamp: |_| 0,
            ..GOOD
        }),
        error
    );
    let half = |at: i64| if at < START + 8_000_000_000 { 0 } else { at };
    let half = faults(&Case {
        camera_stamp: half,
        ..GOOD
    });
    assert_eq!(half, only("stamps", Level::Warning));
}

#[test]
fn actions_twice_as_large_in_z_are_found() {
    let audit = audit(&Case {
        z_factor: 0.5,
        ..GOOD
    });
    let state = audit.faults().find(|finding| finding.check == "state");
    let state = state.unwrap_or_else(|| panic!("{audit}"));
    assert!((state.figures["dz_factor"] - 0.5).abs() < 0.05, "{state:?}");
}

#[test]
fn zero_actions_are_found() {
    let zero = faults(&Case {
        action: |_| [0.0; 3],
        ..GOOD
    });
    assert_eq!(zero.get("lag"), Some(&Level::Warning), "{zero:?}");
}

#[test]
fn missing_topics_are_named() {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    for k in 0..20_i64 {
        let image = CompressedImage {
            header: header(START + k * 100_000_000),
            format: "png".into(),
            data: if k == 7 {
                vec![1, 2, 3]
            } else {
                picture(k, (64, 48))
            },
        };
        let log_ns = u64::try_from(START + k * 100_000_000).unwrap();
        writer
            .write("/front/image_raw/compressed", &image, log_ns)
            .unwrap();
    }
    writer.finish().unwrap();
    let reader = BagReader::open(&bag).unwrap();
    let text = audit_bag(&reader, &Topics::default(), || ()).to_string();
    assert!(text.contains("no actions on /wm/action"), "{text}");
    let unread = "1 messages of /front/image_raw/compressed cannot be read";
    assert!(text.contains(unread), "{text}");
    let named = Topics {
        cameras: vec!["/wrist/image_raw".into()],
        actions: None,
    };
    let text = audit_bag(&reader, &named, || ()).to_string();
    assert!(
        text.contains("no pictures on /wrist/image_raw; the bag has /front/image_raw/compressed"),
        "{text}"
    );
}
