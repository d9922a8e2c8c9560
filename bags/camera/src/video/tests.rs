#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::sync::Arc;

use image::{Rgb, RgbImage};
use openh264::{
    OpenH264API,
    encoder::{BitRate, Encoder, EncoderConfig, IntraFramePeriod, QpRange, RateControlMode},
    formats::{RgbSliceU8, YUVBuffer},
};
use proptest::prelude::*;
use wm_msgs::{builtin_interfaces::Time, std_msgs::Header};

use super::*;

/// Interval of keyframes.
pub(super) const GROUP: usize = 5;

pub(super) fn level(frame: usize) -> u8 {
    30 + 8 * frame as u8
}

/// Packets of grey frames.
pub(super) fn packets(frames: usize) -> Vec<VideoPacket> {
    let config = EncoderConfig::new()
        .rate_control_mode(RateControlMode::Quality)
        .bitrate(BitRate::from_bps(200_000_000))
        .qp(QpRange::new(10, 18))
        .intra_frame_period(IntraFramePeriod::from_num_frames(GROUP as u32))
        .num_threads(1);
    let mut encoder = Encoder::with_api_config(OpenH264API::from_source(), config).unwrap();
    let packet = |frame: usize| {
        let rgb = RgbImage::from_pixel(32, 32, Rgb([level(frame); 3]));
        let source = RgbSliceU8::new(rgb.as_raw(), (32, 32));
        let coded = encoder
            .encode(&YUVBuffer::from_rgb8_source(source))
            .unwrap();
        VideoPacket {
            header: Header {
                stamp: Time::from_nanos(frame as i64 * 100_000_000),
                frame_id: "camera".to_owned(),
            },
            codec: "h264".to_owned(),
            data: coded.to_vec(),
            log_time_ns: 7,
            publish_time_ns: 7,
        }
    };
    (0..frames).map(packet).collect()
}

/// Decodes packets to stamps \[0.1 s\] and grey levels.
fn shown(stream: &mut VideoStream, packets: &[VideoPacket]) -> Vec<(i64, u8)> {
    let mut shown = Vec::new();
    for packet in packets {
        shown.extend(stream.feed(packet).unwrap());
    }
    shown.extend(stream.finish());
    let of = |shown: &VideoPicture| {
        let tenths = shown.header.stamp.to_nanos() / 100_000_000;
        (tenths, shown.picture.get_pixel(9, 9).0[0])
    };
    shown.iter().map(of).collect()
}

fn assert_shows(shown: &[(i64, u8)], frames: impl IntoIterator<Item = usize>) {
    let frames: Vec<usize> = frames.into_iter().collect();
    assert_eq!(shown.len(), frames.len(), "{shown:?}");
    for ((stamp, grey), frame) in shown.iter().zip(frames) {
        assert_eq!(*stamp, frame as i64);
        assert!(grey.abs_diff(level(frame)) <= 2, "frame {frame}: {grey}");
    }
}

#[test]
fn each_packet_gives_its_picture() {
    let mut stream = VideoStream::new();
    assert_shows(&shown(&mut stream, &packets(12)), 0..12);
    assert_eq!(stream.dropped(), DropCounts::default());
}

#[test]
fn stream_begins_with_a_keyframe() {
    let mut stream = VideoStream::new();
    assert_shows(&shown(&mut stream, &packets(12)[2..]), GROUP..12);
    let dropped = DropCounts {
        before_keyframe: 3,
        ..DropCounts::default()
    };
    assert_eq!(stream.dropped(), dropped);
}

#[test]
fn parameters_alone_have_no_picture() {
    let mut packets = packets(6);
    // The units before the first picture, as a separate packet.
    let data = packets[0].data.clone();
    let at = data
        .windows(4)
        .position(|bytes| bytes == [0, 0, 1, 0x65])
        .unwrap();
    let parameters = VideoPacket {
        data: [&data[..at], &[0, 0, 1, 0x06, 5, 0x80]].concat(),
        ..packets[0].clone()
    };
    packets.insert(1, parameters.clone());
    packets.insert(0, parameters);
    let mut stream = VideoStream::new();
    assert_shows(&shown(&mut stream, &packets), 0..6);
    assert_eq!(stream.dropped(), DropCounts::default());
}

#[test]
fn decoding_resumes_at_the_keyframe_after_damage() {
    let mut packets = packets(12);
    // Only the head of the picture.
    packets[2].data.truncate(7);
    let mut stream = VideoStream::new();
    let shown = shown(&mut stream, &packets);
    let last = &shown[shown.len() - 7..];
    assert_shows(last, GROUP..12);
    let wrong = shown
        .iter()
        .filter(|(stamp, grey)| grey.abs_diff(level(*stamp as usize)) > 2);
    assert_eq!(wrong.count(), 0, "{shown:?}");
    let dropped = stream.dropped();
    assert_eq!(dropped.packets() + shown.len() as u64, 12);
    assert_eq!((dropped.damaged, dropped.gaps), (1, 0), "{dropped:?}");
}

#[test]
fn missing_packet_is_a_gap_to_the_next_keyframe() {
    let mut packets = packets(12);
    packets.remove(GROUP + 2);
    let mut stream = VideoStream::new();
    let frames = (0..GROUP + 2).chain(2 * GROUP..12);
    assert_shows(&shown(&mut stream, &packets), frames);
    let dropped = DropCounts {
        gaps: 1,
        dependent: 2,
        ..DropCounts::default()
    };
    assert_eq!(stream.dropped(), dropped);
}

#[test]
fn packet_without_units_is_damaged() {
    let mut packets = packets(2 * GROUP);
    packets[GROUP - 1].data = vec![7; 90];
    packets[2].data.clear();
    let mut stream = VideoStream::new();
    assert_shows(
        &shown(&mut stream, &packets),
        (0..2).chain(GROUP..2 * GROUP),
    );
    let dropped = DropCounts {
        damaged: 2,
        gaps: 1,
        dependent: 1,
        ..DropCounts::default()
    };
    assert_eq!(stream.dropped(), dropped);
}

#[test]
fn other_codecs_are_rejected_by_name() {
    let packet = |codec: &str| VideoPacket {
        codec: codec.to_owned(),
        ..packets(1).remove(0)
    };
    for codec in ["h264", "H264", "libx264", "h264_nvenc;yuv420p;bgr8", "avc1"] {
        assert!(VideoStream::new().feed(&packet(codec)).is_ok(), "{codec}");
    }
    for codec in ["h265", "hevc", "libx265", "vp9", "av1", ""] {
        let error = VideoStream::new()
            .feed(&packet(codec))
            .unwrap_err()
            .to_string();
        assert!(error.contains(&format!("{codec:?}")), "{codec}: {error}");
    }
}

fn message(type_name: &str, data: Vec<u8>) -> wm_bag::BagMessage {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = wm_bag::BagWriter::create(&bag, wm_bag::WriterOptions::default()).unwrap();
    let schema = wm_bag::Schema::ros2msg("uint8[] data");
    writer
        .write_raw("/video", type_name, &schema, 7, &data)
        .unwrap();
    writer.finish().unwrap();
    let reader = wm_bag::BagReader::open(&bag).unwrap();
    let message = reader.messages().next().unwrap().unwrap();
    assert_eq!(message.topic, Arc::from("/video"));
    message
}

#[test]
fn packets_of_each_type_are_read() {
    let expected = packets(1).remove(0);
    let (stamp, frame_id) = (expected.header.stamp, expected.header.frame_id.clone());
    let bytes = serde_bytes::Bytes::new(&expected.data);
    let foxglove = (stamp, &frame_id, bytes, "h264");
    let foxglove = wm_msgs::cdr::to_bytes(&foxglove).unwrap();
    let ffmpeg = (
        &expected.header,
        32_i32,
        32_i32,
        "h264",
        0_u64,
        1_u8,
        false,
        bytes,
    );
    let ffmpeg = wm_msgs::cdr::to_bytes(&ffmpeg).unwrap();
    for (type_name, data) in [
        ("foxglove_msgs/msg/CompressedVideo", foxglove.clone()),
        ("ffmpeg_image_transport_msgs/msg/FFMPEGPacket", ffmpeg),
    ] {
        let read = VideoPacket::of_bag(&message(type_name, data.clone())).unwrap();
        assert_eq!(read, expected, "{type_name}");
        let cut = message(type_name, data[..data.len() / 2].to_vec());
        assert!(VideoPacket::of_bag(&cut).is_err(), "{type_name}");
    }
    assert!(VideoPacket::of_bag(&message("std_msgs/msg/String", foxglove)).is_err());
}

proptest! {
    /// Changed packets give pictures or an error.
    #[test]
    fn stream_survives_changed_packets(
        changes in prop::collection::vec((0_usize..6, 0_usize..400, any::<u8>()), 1..9),
    ) {
        let mut packets = packets(6);
        for (packet, at, value) in changes {
            let data = &mut packets[packet].data;
            let at = at % data.len();
            data[at] = value;
        }
        let mut stream = VideoStream::new();
        for packet in &packets {
            let _ = stream.feed(packet);
        }
        stream.finish();
    }
}
