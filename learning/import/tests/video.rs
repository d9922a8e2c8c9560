//! Video topics of bags in `wm-datasets convert` and `wm-datasets audit`.

use std::{path::Path, process::Command};

use openh264::{
    encoder::Encoder,
    formats::{RgbSliceU8, YUVBuffer},
};
use tempfile::TempDir;
use wm_bag::{BagReader, BagWriter, WriterOptions};
use wm_camera::camera_frame::CameraFrame;
use wm_msgs::{builtin_interfaces::Time, foxglove_msgs::CompressedVideo};

const TOPIC: &str = "/camera/image_raw/video";
const START_NS: i64 = 1_700_000_000_000_000_000;

/// Exit code and standard output.
fn run(command: &str, args: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_wm-datasets"))
        .arg(command)
        .args(args)
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    (output.status.code().unwrap(), text)
}

/// Writes a bag with a video of `frames` frames without the first `skipped`; frame `k` has the level `shown(k)`.
fn write(bag: &Path, (frames, skipped): (u8, u8), shown: fn(u8) -> u8) {
    let mut encoder = Encoder::new().unwrap();
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    for frame in 0..frames {
        if frame % 5 == 0 {
            encoder.force_intra_frame();
        }
        let rgb = vec![40 + 5 * shown(frame); 64 * 48 * 3];
        let source = RgbSliceU8::new(&rgb, (64, 48));
        let coded = encoder
            .encode(&YUVBuffer::from_rgb8_source(source))
            .unwrap();
        if frame < skipped {
            continue;
        }
        let at_ns = START_NS + i64::from(frame) * 100_000_000;
        let packet = CompressedVideo {
            timestamp: Time::from_nanos(at_ns),
            frame_id: "camera".to_owned(),
            data: coded.to_vec(),
            format: "h264".to_owned(),
        };
        let log_ns = u64::try_from(at_ns).unwrap();
        writer.write(TOPIC, &packet, log_ns).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn exit_code_shows_whether_each_packet_has_a_picture() {
    let scratch = TempDir::new().unwrap();
    for (name, skipped, code, pictures) in [("whole", 0, 0, 10), ("cut", 2, 3, 5)] {
        let (old, new) = (
            scratch.path().join(name),
            scratch.path().join(name.to_owned() + "_new"),
        );
        write(&old, (10, skipped), |frame| frame);
        let paths = [old.to_str().unwrap(), new.to_str().unwrap()];
        let args = [&["--jpeg-quality", "80", "--"], paths.as_slice()].concat();
        let (found, text) = run("convert", &args);
        assert_eq!(found, code, "{text}");
        let line = format!("converted {TOPIC} to /camera/image_raw/compressed");
        assert!(text.contains(&line), "{text}");
        let omitted = "3 message(s) are skipped: they come before the first keyframe";
        assert_eq!(text.contains(omitted), code == 3, "{text}");
        let reader = BagReader::open(&new).unwrap();
        let messages = reader.messages().map(Result::unwrap);
        let shown = messages.map(|message| CameraFrame::of_bag(&message).unwrap());
        let sizes: Vec<_> = shown
            .map(|frame| frame.decode().unwrap().dimensions())
            .collect();
        assert_eq!(sizes, vec![(64, 48); pictures]);
        // Existing output is not overwritten.
        assert_eq!(run("convert", &args).0, 1);
    }
}

#[test]
fn pictures_of_a_video_are_audited() {
    let scratch = TempDir::new().unwrap();
    for (name, shown) in [
        ("whole", (|frame| frame) as fn(u8) -> u8),
        ("repeats", |frame| frame / 2 * 2),
        ("frozen", |_| 7),
    ] {
        let bag = scratch.path().join(name);
        write(&bag, (40, 2), shown);
        let (code, text) = run("audit", &["--json", bag.to_str().unwrap()]);
        assert_eq!(code, 0, "{text}");
        let audit: wm_audit::Audit = serde_json::from_str(&text).unwrap();
        let has = |check: &str| audit.findings.iter().any(|finding| finding.check == check);
        for check in ["repeats", "frozen"] {
            assert_eq!(has(check), check == name, "{name}: {audit}");
        }
        let text = audit.to_string();
        assert!(text.contains("64x48, 35 pictures at 10.0 Hz"), "{text}");
        assert!(
            text.contains("3 packets come before the first keyframe"),
            "{text}"
        );
    }
}
