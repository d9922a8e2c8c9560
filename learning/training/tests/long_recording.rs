//! Memory of the preparation of a long recording, which must not grow with its length.

#![cfg(target_os = "linux")]
use std::{path::Path, process::Command, time::Duration};

use wm_bag::{BagWriter, WriterOptions};
use wm_msgs::{builtin_interfaces::Time, sensor_msgs::Image, std_msgs::Header, wm_msgs::Action};

const FRAMES: i64 = 250;
const PERIOD_NS: i64 = 200_000_000;
const HEIGHT: u32 = 480;
const WIDTH: u32 = 640;

fn record(bag: &Path) {
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    for frame in 0..FRAMES {
        let at_ns = frame * PERIOD_NS;
        let header = Header {
            stamp: Time::from_nanos(at_ns),
            frame_id: String::new(),
        };
        let image = Image {
            header: header.clone(),
            height: HEIGHT,
            width: WIDTH,
            encoding: "rgb8".into(),
            step: WIDTH * 3,
            data: vec![frame as u8; (HEIGHT * WIDTH * 3) as usize],
            ..Image::default()
        };
        let at = at_ns as u64;
        writer.write("/camera/image_raw", &image, at).unwrap();
        let values = vec![0.01, 0., 0., 0., 0., 0., 1.];
        let action = Action { header, values };
        writer.write("/wm/action", &action, at).unwrap();
    }
    writer.finish().unwrap();
}

/// Peak memory of a process so far \[MiB\]; `None` once it has ended.
fn most_memory(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024)
}

/// This one-episode recording takes 220 MiB at its prepared size.
#[test]
fn memory_does_not_grow_with_the_recording() {
    let dir = tempfile::tempdir().unwrap();
    let (bag, out) = (dir.path().join("bag"), dir.path().join("out"));
    record(&bag);
    let mut child = Command::new(env!("CARGO_BIN_EXE_wm-training"))
        .arg("dataset")
        .arg(&bag)
        .args(["--size", "480x640", "--out"])
        .arg(&out)
        .spawn()
        .unwrap();
    let mut most = 0;
    let status = loop {
        most = most.max(most_memory(child.id()).unwrap_or(0));
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    assert!(status.success());
    let frames = std::fs::metadata(out.join("frames")).unwrap().len();
    assert_eq!(frames, u64::from(HEIGHT * WIDTH * 3) * FRAMES as u64);
    assert!((1..100).contains(&most), "{most} MiB");
}
