use openh264::{
    OpenH264API,
    encoder::{BitRate, Encoder, EncoderConfig, IntraFramePeriod, QpRange, RateControlMode},
    formats::{RgbSliceU8, YUVBuffer},
};
use wm_bag::type_schema;
use wm_msgs::{Message as _, cdr, foxglove_msgs::CompressedVideo};

use super::{
    super::{DataOptions, StampSource},
    outcome::Outcome,
    *,
};

/// Distance between keyframes.
const GROUP: usize = 10;

/// The grey level that identifies a frame.
fn level(frame: usize) -> u8 {
    30 + 6 * frame as u8
}

/// A bag with a video of grey frames, without the first `skipped`.
fn write_video(bag: &Path, frames: usize, skipped: usize, format: &str) {
    write_stamped(bag, (frames, skipped), format, |stamp| stamp);
}

/// [`write_video`] with other stamps.
fn write_stamped(bag: &Path, frames: (usize, usize), format: &str, stamp: fn(Time) -> Time) {
    write_shown(bag, frames, format, stamp, |frame| frame);
}

/// [`write_stamped`] where frame `k` shows the grey of frame `shown(k)`.
fn write_shown(
    bag: &Path,
    (frames, skipped): (usize, usize),
    format: &str,
    stamp: fn(Time) -> Time,
    shown: fn(usize) -> usize,
) {
    let config = EncoderConfig::new()
        .rate_control_mode(RateControlMode::Quality)
        .bitrate(BitRate::from_bps(200_000_000))
        .qp(QpRange::new(10, 18))
        .intra_frame_period(IntraFramePeriod::from_num_frames(GROUP as u32))
        .num_threads(1);
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).unwrap();
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    let schema = type_schema::<CompressedVideo>();
    for frame in 0..frames {
        let rgb = RgbImage::from_pixel(32, 32, Rgb([level(shown(frame)); 3]));
        let source = RgbSliceU8::new(rgb.as_raw(), (32, 32));
        let coded = encoder
            .encode(&YUVBuffer::from_rgb8_source(source))
            .unwrap();
        if frame < skipped {
            continue;
        }
        let header = header(frame as i64);
        let at = header.stamp.to_nanos() as u64;
        let packet = CompressedVideo {
            timestamp: stamp(header.stamp),
            frame_id: header.frame_id.clone(),
            data: coded.to_vec(),
            format: format.to_owned(),
        };
        let bytes = cdr::to_bytes(&packet).unwrap();
        writer
            .write_raw(
                "/camera/image_raw/video",
                &CompressedVideo::ros_name(),
                &schema,
                at,
                &bytes,
            )
            .unwrap();
        let action = Action {
            header,
            values: vec![0.01 * (frame % 3) as f32, 0., 0., 0., 0., 0., 0.],
        };
        writer.write("/wm/action", &action, at).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn frames_of_a_video_topic_are_read() {
    let dir = tempfile::tempdir().unwrap();
    for (name, skipped, first) in [("whole", 0, 0), ("cut", 4, GROUP)] {
        let bag = dir.path().join(name);
        write_video(&bag, 25, skipped, "h264");
        let dataset = Dataset::open(&bag, &dir.path().join("cache"), (16, 16)).unwrap();
        assert_eq!(dataset.frame_count(), 25 - first, "{name}");
        for frame in first..25 {
            let picture = dataset.frame(frame - first).unwrap();
            let off = picture
                .iter()
                .map(|value| value.abs_diff(level(frame)))
                .max();
            assert!(off <= Some(2), "{name}: frame {frame} is off by {off:?}");
        }
    }
}

#[test]
fn episode_in_a_video_begins_with_its_own_frames() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_video(&bag, 25, 0, "h264");
    let options = DataOptions {
        cut_seconds: Some(1.0),
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    // Most episodes start between keyframes.
    assert_eq!(outcome.lengths(), [5; 5]);
    for (frame, red) in outcome.reds().into_iter().enumerate() {
        assert!(red.abs_diff(level(frame)) <= 2, "frame {frame}: {red}");
    }
}

#[test]
fn unstamped_video_is_dated_by_recording_time() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_stamped(&bag, (36, 0), "h264", |_| Time::default());
    let refused = Outcome::of(&bag, DataOptions::default());
    let error = refused.map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("--stamps log"), "{error}");
    let options = DataOptions {
        stamps: Some(StampSource::Log),
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&bag, options).unwrap();
    assert_eq!(outcome.lengths(), [36]);
    for (frame, red) in outcome.reds().into_iter().enumerate() {
        assert!(red.abs_diff(level(frame)) <= 2, "frame {frame}: {red}");
    }
    // Its pictures are compared with each other, as in other topics.
    let audit = outcome.audit.to_string();
    assert!(
        audit.contains("lag") && !audit.contains("no pictures were compared"),
        "{audit}"
    );
}

#[test]
fn repeated_and_frozen_pictures_of_a_video_are_found() {
    let dir = tempfile::tempdir().unwrap();
    for (name, shown) in [
        ("whole", (|frame| frame) as fn(usize) -> usize),
        ("repeats", |frame| frame / 2 * 2),
        ("frozen", |_| 3),
    ] {
        let bag = dir.path().join(name);
        write_shown(&bag, (36, 0), "h264", |stamp| stamp, shown);
        let audit = Outcome::of(&bag, DataOptions::default()).unwrap().audit;
        let found: Vec<&str> = audit.faults().map(|finding| &*finding.check).collect();
        for check in ["repeats", "frozen"] {
            assert_eq!(found.contains(&check), check == name, "{name}: {audit}");
        }
    }
}

#[test]
fn video_in_another_codec_is_rejected_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    write_video(&bag, 3, 0, "h265");
    let error = Dataset::open(&bag, &dir.path().join("cache"), (16, 16)).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("\"h265\"") && text.contains("h264"), "{text}");
}

/// A recording by Foxglove's tools, with actions beside it.
#[test]
fn video_in_protobuf_is_read() {
    const START_NS: i64 = 1_750_000_000_000_000_000;
    let dir = tempfile::tempdir().unwrap();
    let (bag, actions) = (dir.path().join("bag"), dir.path().join("actions"));
    let mut writer = BagWriter::create(&actions, WriterOptions::default()).unwrap();
    for index in 0..6 {
        let at_ns = START_NS + index * 200_000_000;
        let mut header = header(index);
        header.stamp = Time::from_nanos(at_ns);
        let values = vec![0.01, 0., 0., 0., 0., 0., 0.];
        let action = Action { header, values };
        writer.write("/wm/action", &action, at_ns as u64).unwrap();
    }
    writer.finish().unwrap();
    std::fs::create_dir(&bag).unwrap();
    std::fs::copy(actions.join("actions_0.mcap"), bag.join("bag_1.mcap")).unwrap();
    let pictures = "../../bags/camera/fixtures/protobuf/pictures.mcap";
    let pictures = Path::new(env!("CARGO_MANIFEST_DIR")).join(pictures);
    std::fs::copy(pictures, bag.join("bag_0.mcap")).unwrap();
    // Join both files into one bag; its pictures stay in protobuf.
    let joined = dir.path().join("joined");
    wm_bag::convert(&bag, &joined, WriterOptions::default(), &mut []).unwrap();
    let options = DataOptions {
        cameras: vec!["/camera/video".to_owned()],
        ..DataOptions::default()
    };
    let outcome = Outcome::of(&joined, options).unwrap();
    assert_eq!(outcome.lengths(), [5]);
    for (frame, red) in outcome.reds().into_iter().enumerate() {
        // Ten pictures per second, for five actions.
        assert!(red.abs_diff(40 + 20 * frame as u8) <= 2, "{frame}: {red}");
    }
}

#[test]
fn depth_is_not_a_camera() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    for index in 0..3 {
        let header = header(index);
        let at = header.stamp.to_nanos() as u64;
        let depth = CompressedImage {
            header: header.clone(),
            format: "16UC1; compressedDepth png".into(),
            data: vec![0; 40],
        };
        let topic = "/camera/image_raw/compressedDepth";
        writer.write(topic, &depth, at).unwrap();
        let action = Action {
            header,
            values: vec![0.; 7],
        };
        writer.write("/wm/action", &action, at).unwrap();
    }
    writer.finish().unwrap();
    let error = Dataset::open(&bag, &dir.path().join("cache"), (16, 16)).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("compressedDepth has distances"), "{text}");
}
