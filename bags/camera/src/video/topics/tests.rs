#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::path::Path;

use wm_bag::{BagWarning, BagWriter, Conversion, QosProfile, Schema, WriterOptions, convert};

use super::{super::tests::*, *};
use crate::camera_frame::CameraFrame;

const FOXGLOVE: &str = "foxglove_msgs/msg/CompressedVideo";
const FFMPEG: &str = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket";
const TOPIC: &str = "/camera/image_raw/ffmpeg";
const START_NS: u64 = 1_750_000_000_000_000_000;

/// Encodes a packet as a message of a type.
fn message(type_name: &str, packet: &VideoPacket) -> Vec<u8> {
    let bytes = serde_bytes::Bytes::new(&packet.data);
    let (header, codec) = (&packet.header, packet.codec.as_str());
    match type_name {
        FFMPEG => cdr::to_bytes(&(header, 32_i32, 32_i32, codec, 0_u64, 1_u8, false, bytes)),
        _ => cdr::to_bytes(&(header.stamp, &header.frame_id, bytes, codec)),
    }
    .unwrap()
}

/// Writes a bag with these packets, 0.1 s apart, on a best-effort topic, and a text.
fn write(bag: &Path, topic: &str, type_name: &str, packets: &[(usize, VideoPacket)]) {
    let mut writer = BagWriter::create(bag, WriterOptions::default()).unwrap();
    let schema = Schema::ros2msg("uint8[] data");
    let qos = QosProfile::sensor_data().to_yaml();
    writer
        .add_topic_raw(topic, type_name, &schema, &qos)
        .unwrap();
    for (frame, packet) in packets {
        let log_ns = START_NS + *frame as u64 * 100_000_000;
        let data = message(type_name, packet);
        writer
            .write_raw(topic, type_name, &schema, log_ns, &data)
            .unwrap();
    }
    let text = wm_msgs::std_msgs::String { data: "a".into() };
    writer.write("/note", &text, START_NS).unwrap();
    writer.finish().unwrap();
}

/// Packets with their numbers, which give the recording times.
type NumberedPackets = Vec<(usize, VideoPacket)>;

fn numbered(frames: usize) -> NumberedPackets {
    packets(frames).into_iter().enumerate().collect()
}

fn converted(folder: &Path) -> Conversion {
    let (old, new) = (folder.join("old"), folder.join("new"));
    let topics = VideoTopics::of(&BagReader::open(&old).unwrap(), 95);
    assert_eq!(topics.skipped(), []);
    let mut transforms: [Box<dyn Transform>; 1] = [Box::new(topics)];
    convert(&old, &new, WriterOptions::default(), &mut transforms).unwrap()
}

/// Checks the frames of a topic's pictures by their stamps.
fn assert_pictures(bag: &Path, topic: &str, frames: impl IntoIterator<Item = usize>) {
    let reader = BagReader::open(bag).unwrap();
    let mut messages = reader.messages().only_topics([topic]);
    for frame in frames {
        let message = messages.next().unwrap().unwrap();
        let shown = CameraFrame::of_bag(&message).unwrap();
        let header = shown.header();
        assert_eq!(header.stamp.to_nanos(), frame as i64 * 100_000_000);
        assert_eq!(header.frame_id, "camera");
        let log_ns = START_NS + frame as u64 * 100_000_000;
        let times = (message.log_time_ns, message.publish_time_ns);
        assert_eq!(times, (log_ns, log_ns));
        let grey = shown.decode().unwrap().get_pixel(9, 9).0[0];
        assert!(grey.abs_diff(level(frame)) <= 3, "frame {frame}: {grey}");
    }
    assert!(messages.next().is_none());
}

#[test]
fn video_topics_become_pictures() {
    for type_name in [FOXGLOVE, FFMPEG] {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("old"), TOPIC, type_name, &numbered(12));
        let made = converted(folder.path());
        assert!(!made.is_lossy(), "{made}");
        let name = "/camera/image_raw/compressed";
        assert_eq!(made.transformed, [(TOPIC.to_owned(), name.to_owned())]);
        let new = folder.path().join("new");
        assert_pictures(&new, name, 0..12);
        let reader = BagReader::open(&new).unwrap();
        let qos = reader.topic(name).unwrap().qos();
        assert_eq!(qos, Some(QosProfile::sensor_data()));
        assert_eq!(reader.topic("/note").unwrap().message_count, 1);
        assert!(reader.topic(TOPIC).is_none());
    }
}

#[test]
fn omitted_packets_are_counted_by_cause() {
    let folder = tempfile::tempdir().unwrap();
    let mut packets = numbered(16);
    // A truncated picture; the rest of its group depends on it.
    packets[12].1.data.truncate(7);
    // A missing packet.
    packets.remove(GROUP + 2);
    packets.drain(..2);
    write(&folder.path().join("old"), TOPIC, FOXGLOVE, &packets);
    let made = converted(folder.path());
    assert!(made.is_lossy());
    let frames = [5, 6, 10, 11, 15];
    assert_pictures(
        &folder.path().join("new"),
        "/camera/image_raw/compressed",
        frames,
    );
    let mut found = Vec::new();
    for warning in &made.warnings {
        if let BagWarning::Omitted {
            topic,
            messages,
            reason,
        } = warning
        {
            assert_eq!(topic, TOPIC);
            found.push((*messages, reason.as_str()));
        }
    }
    assert_eq!(found.len(), 3, "{made}");
    assert!(found[0].0 == 3 && found[0].1.contains("first keyframe"));
    assert!(found[1].0 == 1 && found[1].1.contains("damaged"));
    assert!(
        found[2].0 == 4 && found[2].1.contains("in 1 place"),
        "{made}"
    );
    let all: u64 = found.iter().map(|(messages, _)| messages).sum();
    assert_eq!(all as usize + frames.len(), packets.len());
}

#[test]
fn undecodable_video_is_copied_and_named() {
    let mut other = numbered(3);
    other
        .iter_mut()
        .for_each(|(_, packet)| packet.codec = "hevc".into());
    let inner = numbered(4).split_off(1);
    for (packets, expected) in [(other, "hevc"), (inner, "keyframe")] {
        let folder = tempfile::tempdir().unwrap();
        let (old, new) = (folder.path().join("old"), folder.path().join("new"));
        write(&old, TOPIC, FOXGLOVE, &packets);
        let topics = VideoTopics::of(&BagReader::open(&old).unwrap(), 95);
        let [(topic, reason)] = topics.skipped() else {
            panic!("{topics:?}");
        };
        assert_eq!(topic, TOPIC);
        assert!(reason.contains(expected), "{reason}");
        let mut transforms: [Box<dyn Transform>; 1] = [Box::new(topics)];
        let made = convert(&old, &new, WriterOptions::default(), &mut transforms).unwrap();
        assert!(!made.is_lossy(), "{made}");
        let kept = BagReader::open(&new).unwrap();
        let kept = kept.topic(TOPIC).unwrap().message_count;
        assert_eq!(kept, packets.len() as u64);
    }
}

#[test]
fn new_name_is_free_in_the_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = BagWriter::create(&bag, WriterOptions::default()).unwrap();
    let schema = Schema::ros2msg("uint8[] data");
    let data = message(FOXGLOVE, &packets(1)[0]);
    for topic in ["/c/ffmpeg", "/c/h264", "/d/video"] {
        writer
            .write_raw(topic, FOXGLOVE, &schema, 1, &data)
            .unwrap();
    }
    for topic in ["/d/compressed", "/d/video/compressed"] {
        let image = CompressedImage::default();
        writer.write(topic, &image, 1).unwrap();
    }
    writer.finish().unwrap();
    let topics = VideoTopics::of(&BagReader::open(&bag).unwrap(), 95);
    let names: Vec<(&str, &str)> = topics
        .names
        .iter()
        .map(|(old, new)| (old.as_str(), new.as_str()))
        .collect();
    let expected = [
        ("/c/ffmpeg", "/c/compressed"),
        ("/c/h264", "/c/h264/compressed"),
    ];
    assert_eq!(names, expected);
    assert_eq!(topics.skipped().len(), 1);
    assert_eq!(topics.skipped()[0].0, "/d/video");
}

/// Runs ffmpeg; `None` if it or a component is not installed.
fn ffmpeg(args: &[&str], input: &[u8]) -> Option<Vec<u8>> {
    use std::{
        io::Write as _,
        process::{Command, Stdio},
    };
    let mut child = Command::new("ffmpeg")
        .args(["-v", "error"])
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .ok()?;
    let mut stdin = child.stdin.take().unwrap();
    let input = input.to_vec();
    let writer = std::thread::spawn(move || stdin.write_all(&input));
    let output = child.wait_with_output().unwrap();
    // A write error means that the program ended early.
    let _ = writer.join().unwrap();
    output.status.success().then_some(output.stdout)
}

const SIDE: u32 = 64;
const FRAMES: usize = 30;
/// Size of a picture \[bytes\].
const PICTURE: usize = (SIDE * SIDE * 3) as usize;

/// Encodes with ffmpeg, with a keyframe every ten packets; returns packets and the pictures that ffmpeg decodes from them.
fn coded_by_ffmpeg(b_frames: &str) -> Option<(NumberedPackets, Vec<u8>)> {
    let raw: Vec<u8> = (0..FRAMES as u32)
        .flat_map(|frame| {
            let pixel = move |x: u32, y: u32| {
                let is_inside = (x.abs_diff(frame + 16) < 8) && (y.abs_diff(32) < 8);
                let ground = image::Rgb([(x * 4) as u8, (y * 4) as u8, (frame * 7) as u8]);
                if is_inside {
                    image::Rgb([230, 40, 200])
                } else {
                    ground
                }
            };
            image::RgbImage::from_fn(SIDE, SIDE, pixel).into_raw()
        })
        .collect();
    let rgb = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "64x64"];
    let encode = [
        &rgb[..],
        &[
            "-r", "10", "-i", "-", "-c:v", "libx264", "-g", "10", "-bf", b_frames,
        ],
        &["-pix_fmt", "yuv420p", "-bsf:v", "h264_metadata=aud=insert"],
    ]
    .concat();
    let as_format = |format| ffmpeg(&[&encode, &["-f", format, "-"][..]].concat(), &raw);
    let coded = as_format("h264")?;
    // Columns: stream, decoding time, presentation time, and more.
    let lines = String::from_utf8(as_format("framecrc")?).unwrap();
    let lines = lines.lines().filter(|line| !line.starts_with('#'));
    let shown_at = lines.map(|line| line.split(',').nth(2).unwrap().trim().parse::<i64>());
    let shown_at: Vec<i64> = shown_at.map(Result::unwrap).collect();
    let decode = [
        "-f", "h264", "-i", "-", "-f", "rawvideo", "-pix_fmt", "rgb24", "-",
    ];
    let expected = ffmpeg(&decode, &coded).unwrap();
    // Each packet begins with an access unit delimiter.
    let delimiter = [0, 0, 0, 1, 9];
    let starts: Vec<usize> = (0..coded.len())
        .filter(|at| coded[*at..].starts_with(&delimiter))
        .collect();
    assert_eq!(starts.len(), FRAMES);
    let ends = starts[1..].iter().copied().chain([coded.len()]);
    let packets = starts.iter().zip(ends).enumerate();
    let packets = packets
        .map(|(frame, (start, end))| {
            let mut packet = super::super::tests::packets(1).remove(0);
            packet.header.stamp =
                wm_msgs::builtin_interfaces::Time::from_nanos(shown_at[frame] * 100_000_000);
            packet.data = coded[*start..end].to_vec();
            (frame, packet)
        })
        .collect();
    Some((packets, expected))
}

#[test]
fn pictures_equal_those_of_ffmpeg() {
    for b_frames in ["0", "2"] {
        let Some((packets, expected)) = coded_by_ffmpeg(b_frames) else {
            eprintln!("skipped: ffmpeg with libx264 is not installed");
            return;
        };
        assert_pictures_of_ffmpeg(&packets, &expected);
    }
}

fn assert_pictures_of_ffmpeg(packets: &[(usize, VideoPacket)], expected: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("old"), TOPIC, FFMPEG, packets);
    let made = converted(folder.path());
    assert!(!made.is_lossy(), "{made}");
    let reader = BagReader::open(folder.path().join("new")).unwrap();
    let messages = reader
        .messages()
        .only_topics(["/camera/image_raw/compressed"]);
    let mut count = 0;
    for (message, expected) in messages.zip(expected.chunks(PICTURE)) {
        let shown = CameraFrame::of_bag(&message.unwrap()).unwrap();
        assert_eq!(shown.header().stamp.to_nanos(), count * 100_000_000);
        let shown = shown.decode().unwrap();
        let pairs = shown.as_raw().iter().zip(expected);
        let sum: u64 = pairs.map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        let mean = sum as f64 / PICTURE as f64;
        assert!(mean < 2.0, "frame {count}: {mean}");
        count += 1;
    }
    assert_eq!(count, FRAMES as i64);
}

/// With this encoder, the decoder delays each picture until the next packet.
#[test]
fn pictures_before_a_gap_are_kept() {
    let Some((mut packets, _)) = coded_by_ffmpeg("0") else {
        eprintln!("skipped: ffmpeg with libx264 is not installed");
        return;
    };
    packets.remove(13);
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("old"), TOPIC, FFMPEG, &packets);
    let made = converted(folder.path());
    let [BagWarning::Omitted { messages: 6, .. }] = made.warnings.as_slice() else {
        panic!("{made}");
    };
    let reader = BagReader::open(folder.path().join("new")).unwrap();
    let name = "/camera/image_raw/compressed";
    let messages = reader.messages().only_topics([name]);
    let frames: Vec<i64> = messages
        .map(|message| CameraFrame::of_bag(&message.unwrap()).unwrap())
        .map(|frame| frame.header().stamp.to_nanos() / 100_000_000)
        .collect();
    let expected: Vec<i64> = (0..13).chain(20..30).collect();
    assert_eq!(frames, expected);
}
