#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::path::Path;

use proptest::prelude::*;
use prost::Message as _;
use wm_bag::{BagReader, BagWarning, Transform, WriterOptions, convert};

use super::*;
use crate::{camera_frame::CameraFrame, protobuf_topics::ProtobufTopics, transport::Transport};

const START_NS: i64 = 1_750_000_000_000_000_000;

/// Opens a file of Foxglove's own libraries.
fn reader() -> BagReader {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/protobuf/pictures.mcap");
    BagReader::open(file).unwrap()
}

fn messages(reader: &BagReader, topic: &str) -> Vec<BagMessage> {
    let messages = reader.messages().only_topics([topic]);
    messages.map(Result::unwrap).collect()
}

#[test]
fn pictures_in_protobuf_are_read() {
    let reader = reader();
    for topic in ["/camera/jpeg", "/camera/raw"] {
        let messages = messages(&reader, topic);
        assert_eq!(messages.len(), 2);
        for (message, frame) in messages.iter().zip(0_u8..) {
            let transport = Transport::of(topic, &message.type_name).unwrap();
            assert!(transport.is_read());
            let shown = CameraFrame::of_bag(message).unwrap();
            let header = shown.header();
            let at_ns = START_NS + i64::from(frame) * 100_000_000;
            assert_eq!(header.stamp.to_nanos(), at_ns);
            assert_eq!(header.frame_id, "camera");
            let picture = shown.decode().unwrap();
            assert_eq!(picture.dimensions(), (64, 48));
            let grey = picture.get_pixel(9, 9).0[1];
            assert!(grey.abs_diff(40 + 10 * frame) <= 1, "{topic}: {grey}");
        }
    }
}

#[test]
fn other_protobuf_types_are_skipped_by_name() {
    let reader = reader();
    let [BagWarning::ChannelSkipped { topic, reason, .. }] = reader.warnings() else {
        panic!("{:?}", reader.warnings());
    };
    assert_eq!(topic, "/note");
    assert!(
        reason.contains("google.protobuf.StringValue")
            && reason.contains("foxglove.CompressedVideo"),
        "{reason}"
    );
}

#[test]
fn converted_bag_has_the_same_pictures_in_cdr() {
    let folder = tempfile::tempdir().unwrap();
    let old = reader();
    let new = folder.path().join("new");
    let mut transforms: [Box<dyn Transform>; 1] = [Box::new(ProtobufTopics)];
    let options = WriterOptions::default();
    let made = convert(old.path(), &new, options, &mut transforms).unwrap();
    assert!(!made.is_lossy(), "{made}");
    assert_eq!(made.undefined, Vec::<String>::new());
    let new = BagReader::open(&new).unwrap();
    let is_cdr = |topic: &wm_bag::TopicInfo| topic.encoding == MessageEncoding::Cdr;
    assert!(new.topics().len() == 3 && new.topics().iter().all(is_cdr));
    for topic in ["/camera/jpeg", "/camera/raw", "/camera/video"] {
        let both = [&old, &new].map(|reader| messages(reader, topic));
        let [old, new] = &both;
        assert_eq!(old.len(), new.len());
        for (old, new) in old.iter().zip(new) {
            assert_eq!(old.log_time_ns, new.log_time_ns);
            if topic == "/camera/video" {
                let both = [old, new].map(|message| compressed_video(message).unwrap());
                assert_eq!(both[0], both[1]);
                assert_eq!(both[0].format, "h264");
                continue;
            }
            let both = [old, new].map(|message| CameraFrame::of_bag(message).unwrap());
            assert_eq!(both[0].header(), both[1].header());
            assert_eq!(both[0].fingerprint(), both[1].fingerprint());
        }
    }
    let description = wm_bag::type_schema::<CompressedVideo>().description(ROS_VIDEO[0]);
    assert_eq!(description.unwrap().unwrap().described.fields.len(), 4);
}

#[cfg(feature = "video")]
#[test]
fn video_in_protobuf_becomes_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (reader(), folder.path().join("new"));
    let topics = crate::video::VideoTopics::of(&old, 95);
    assert_eq!(topics.skipped(), []);
    let mut transforms: [Box<dyn Transform>; 2] = [Box::new(topics), Box::new(ProtobufTopics)];
    let options = WriterOptions::default();
    let made = convert(old.path(), &new, options, &mut transforms).unwrap();
    assert!(!made.is_lossy(), "{made}");
    let pictures = messages(&BagReader::open(&new).unwrap(), "/camera/compressed");
    assert_eq!(pictures.len(), 10);
    for (message, frame) in pictures.iter().zip(0_u8..) {
        let shown = CameraFrame::of_bag(message).unwrap();
        let at_ns = START_NS + i64::from(frame) * 100_000_000;
        assert_eq!(shown.header().stamp.to_nanos(), at_ns);
        let grey = shown.decode().unwrap().get_pixel(9, 9).0[1];
        assert!(grey.abs_diff(40 + 10 * frame) <= 3, "{frame}: {grey}");
    }
}

#[test]
fn copies_keep_protobuf() {
    let folder = tempfile::tempdir().unwrap();
    let old = reader();
    let (part, recovered) = (folder.path().join("part"), folder.path().join("recovered"));
    let (start, end) = (wm_bag::CutStart::Beginning, wm_bag::CutEnd::End);
    wm_bag::cut(
        old.path(),
        &part,
        start,
        end,
        &wm_bag::TopicFilter::default(),
    )
    .unwrap();
    wm_bag::recover(old.path(), &recovered).unwrap();
    for copy in [part, recovered] {
        let copy = BagReader::open(&copy).unwrap();
        for topic in old.topics() {
            let both = [&old, &copy].map(|reader| messages(reader, &topic.name));
            assert_eq!(both[0], both[1]);
        }
        let formats = copy.summary().topics;
        assert!(
            formats
                .iter()
                .all(|topic| topic.serialization_format == "protobuf")
        );
    }
}

#[test]
fn times_outside_the_range_of_ros_are_rejected() {
    let mut message = messages(&reader(), "/camera/video").remove(0);
    for (seconds, nanos, is_good) in [
        (5, 999_999_999, true),
        (5, 1_000_000_000, false),
        (5, -1, false),
        (1 << 40, 0, false),
    ] {
        let video = Video {
            timestamp: Some(Timestamp { seconds, nanos }),
            ..Video::default()
        };
        message.data = video.encode_to_vec().into();
        let read = compressed_video(&message);
        assert_eq!(read.is_ok(), is_good, "{seconds} s {nanos} ns: {read:?}");
    }
    message.data = Video::default().encode_to_vec().into();
    let read = compressed_video(&message).unwrap();
    assert_eq!(read.timestamp, Time::default());
}

proptest! {
    #[test]
    fn decoder_survives_arbitrary_bytes(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let reader = reader();
        for topic in ["/camera/jpeg", "/camera/raw", "/camera/video"] {
            let mut message = messages(&reader, topic).remove(0);
            message.data = bytes.clone().into();
            let _ = compressed_video(&message);
            let _ = CameraFrame::of_bag(&message).map(|frame| frame.decode());
        }
    }

    #[test]
    fn truncated_messages_are_errors_or_shorter(share in 0.0..1.0) {
        let reader = reader();
        let mut message = messages(&reader, "/camera/raw").remove(0);
        let whole = raw_image(&message).unwrap();
        let length = (message.data.len() as f64 * share) as usize;
        message.data = message.data.slice(..length);
        if let Ok(image) = raw_image(&message) {
            prop_assert!(image.data.len() <= whole.data.len());
            prop_assert_ne!(image, whole);
        }
    }
}
