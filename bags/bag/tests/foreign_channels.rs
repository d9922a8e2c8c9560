//! Bags of other programs: unreadable channels, and definitions with other fields.

use std::{collections::BTreeMap, fs, path::PathBuf};

use mcap::{WriteOptions, records::MessageHeader};
use tempfile::TempDir;
use wm_bag::{BagReader, BagWarning, CutEnd, CutStart, TopicFilter, cut, recover};
use wm_msgs::{cdr, std_msgs::String as Text, wm_msgs::Action};

const START_NS: u64 = 1_750_000_000_000_000_000;

/// Builds an MCAP file.
struct McapFile {
    writer: mcap::Writer<std::io::Cursor<Vec<u8>>>,
}

impl McapFile {
    fn new() -> Self {
        let options = WriteOptions::new().profile("ros2");
        Self {
            writer: options.create(std::io::Cursor::new(Vec::new())).unwrap(),
        }
    }

    fn channel(
        &mut self,
        topic: &str,
        schema: Option<(&str, &str, &str)>,
        encoding: &str,
        messages: &[Vec<u8>],
    ) -> u16 {
        let schema = schema.map_or(0, |(name, encoding, text)| {
            self.writer
                .add_schema(name, encoding, text.as_bytes())
                .unwrap()
        });
        let channel = self
            .writer
            .add_channel(schema, topic, encoding, &BTreeMap::new());
        let channel_id = channel.unwrap();
        for (number, data) in messages.iter().enumerate() {
            let log_time = START_NS + number as u64 * 100_000_000;
            let header = MessageHeader {
                channel_id,
                sequence: number as u32,
                log_time,
                publish_time: log_time,
            };
            self.writer.write_to_known_channel(&header, data).unwrap();
        }
        channel_id
    }

    fn write(mut self, scratch: &TempDir) -> PathBuf {
        self.writer.finish().unwrap();
        let path = scratch.path().join("foreign.mcap");
        fs::write(&path, self.writer.into_inner().into_inner()).unwrap();
        path
    }
}

fn text(data: &str) -> Vec<u8> {
    cdr::to_bytes(&Text { data: data.into() }).unwrap()
}

fn texts(reader: &BagReader) -> Vec<String> {
    let messages = reader.messages().map(Result::unwrap);
    messages
        .map(|message| message.decode::<Text>().unwrap().data)
        .collect()
}

#[test]
fn unreadable_channels_are_skipped_by_name() {
    let scratch = TempDir::new().unwrap();
    let mut file = McapFile::new();
    let string = ("std_msgs/msg/String", "ros2msg", "string data");
    file.channel(
        "/json",
        Some(("foxglove.Image", "jsonschema", "{}")),
        "json",
        &[b"{}".to_vec()],
    );
    file.channel(
        "/protobuf",
        Some(("foxglove.Video", "protobuf", "")),
        "protobuf",
        &[vec![1], vec![2]],
    );
    file.channel(
        "/ros1",
        Some(("sensor_msgs/Image", "ros1msg", "")),
        "ros1",
        &[vec![0; 60]],
    );
    file.channel("/nothing", None, "cdr", &[text("x")]);
    file.channel(
        "/odd",
        Some(("foxglove.Scene", "omgidl", "struct S {};")),
        "cdr",
        &[text("x")],
    );
    file.channel(
        "/text",
        Some(string),
        "cdr",
        &[text("a"), text("b"), text("c")],
    );
    let path = file.write(&scratch);

    let reader = BagReader::open(&path).unwrap();
    assert_eq!(texts(&reader), ["a", "b", "c"]);
    assert_eq!(reader.message_count(), 3);
    let left_out: Vec<(&str, u64)> = reader
        .warnings()
        .iter()
        .map(|warning| match warning {
            BagWarning::ChannelSkipped {
                topic, messages, ..
            } => (topic.as_str(), *messages),
            other => panic!("{other}"),
        })
        .collect();
    let expected = [
        ("/json", 1),
        ("/protobuf", 2),
        ("/ros1", 1),
        ("/nothing", 1),
        ("/odd", 1),
    ];
    assert_eq!(left_out, expected);

    let part = scratch.path().join("part");
    let all = TopicFilter::default();
    cut(&path, &part, CutStart::Beginning, CutEnd::End, &all).unwrap();
    assert_eq!(texts(&BagReader::open(&part).unwrap()), ["a", "b", "c"]);
    let recovered = recover(&path, scratch.path().join("recovered")).unwrap();
    let text = recovered.losses.to_string();
    assert_eq!(
        (
            recovered.losses.messages,
            recovered.losses.by_topic["/protobuf"]
        ),
        (6, 2)
    );
    assert!(
        text.contains("/json: 1") && text.contains("/odd: 1"),
        "{text}"
    );
}

#[test]
fn messages_of_an_undefined_channel_are_counted() {
    let scratch = TempDir::new().unwrap();
    let record = |opcode: u8, body: &[u8]| {
        let length = (body.len() as u64).to_le_bytes();
        [&[opcode][..], &length, body].concat()
    };
    // Channel 7, sequence number, log and publish time.
    let message = [&[7, 0, 1, 0, 0, 0][..], &[0; 16], &[0, 1, 0, 0]].concat();
    let parts = [
        mcap::MAGIC.to_vec(),
        record(mcap::records::op::HEADER, &[0; 8]),
        record(mcap::records::op::MESSAGE, &message),
        record(mcap::records::op::MESSAGE, &message),
        record(mcap::records::op::DATA_END, &[0; 4]),
        record(mcap::records::op::FOOTER, &[0; 20]),
        mcap::MAGIC.to_vec(),
    ];
    let path = scratch.path().join("undefined.mcap");
    fs::write(&path, parts.concat()).unwrap();
    let reader = BagReader::open(&path).unwrap();
    assert_eq!(reader.message_count(), 0);
    let warnings: Vec<String> = reader.warnings().iter().map(ToString::to_string).collect();
    assert!(
        warnings
            .iter()
            .any(|w| w.contains("channel number 7 with 2 message(s)")),
        "{warnings:?}"
    );
}

#[test]
fn most_frequent_type_of_a_topic_is_kept() {
    let scratch = TempDir::new().unwrap();
    let mut file = McapFile::new();
    let float = ("std_msgs/msg/Float32", "ros2msg", "float32 data");
    file.channel("/x", Some(float), "cdr", &[vec![0, 1, 0, 0, 0, 0, 0, 0]]);
    let string = ("std_msgs/msg/String", "ros2msg", "string data");
    file.channel("/x", Some(string), "cdr", &[text("a"), text("b")]);
    let reader = BagReader::open(file.write(&scratch)).unwrap();
    assert_eq!(texts(&reader), ["a", "b"]);
    assert_eq!(
        &*reader.topic("/x").unwrap().type_name,
        "std_msgs/msg/String"
    );
    let warning = reader.warnings()[0].to_string();
    assert!(
        warning.contains("/x with 1 message") && warning.contains("Float32"),
        "{warning}"
    );
}

#[test]
fn topic_without_leading_slash_gets_one() {
    let scratch = TempDir::new().unwrap();
    let mut file = McapFile::new();
    let string = ("std_msgs/msg/String", "ros2msg", "string data");
    file.channel("task/instruction", Some(string), "cdr", &[text("push")]);
    let path = file.write(&scratch);
    let reader = BagReader::open(&path).unwrap();
    assert!(reader.topic("/task/instruction").unwrap().is_latched());
    let part = scratch.path().join("part");
    let named = TopicFilter::new(vec!["/task/instruction".into()], None, vec![], None).unwrap();
    cut(&path, &part, CutStart::Beginning, CutEnd::End, &named).unwrap();
    assert_eq!(
        BagReader::open(&part).unwrap().topics()[0].name.as_ref(),
        "/task/instruction"
    );
}

/// A header at 1 s in the frame "b".
const HEADER: [u8; 16] = [1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, b'b', 0, 0, 0];

#[test]
fn other_fields_are_named_and_values_keep_their_names() {
    let scratch = TempDir::new().unwrap();
    let mut file = McapFile::new();
    let definition = "std_msgs/Header header\nuint32 mode\nfloat32[] values\n";
    let schema = ("wm_msgs/msg/Action", "ros2msg", definition);
    let values = [
        &[2, 0, 0, 0][..],
        &0.5f32.to_le_bytes(),
        &1f32.to_le_bytes(),
    ]
    .concat();
    let message = [&[0, 1, 0, 0][..], &HEADER, &[7, 0, 0, 0], &values].concat();
    file.channel("/wm/action", Some(schema), "cdr", &[message]);
    let narrow = ("wm_msgs/msg/Action", "ros2msg", "float64[] values\n");
    file.channel("/double/action", Some(narrow), "cdr", &[vec![0; 20]]);
    let path = file.write(&scratch);
    let reader = BagReader::open(&path).unwrap();
    let actions: Vec<_> = reader
        .messages()
        .map(|m| m.unwrap().decode::<Action>())
        .collect();
    assert_eq!(actions[0].as_ref().unwrap().values, [0.5, 1.0]);
    assert_eq!(actions[0].as_ref().unwrap().header.stamp.sec, 1);
    let refused = actions[1].as_ref().unwrap_err().to_string();
    assert!(
        refused.contains("/double/action") && refused.contains("float64[]"),
        "{refused}"
    );
    let warnings: Vec<String> = reader.warnings().iter().map(ToString::to_string).collect();
    assert!(
        warnings[0].contains("/wm/action") && warnings[0].contains("ignored: mode"),
        "{warnings:?}"
    );
    assert!(
        warnings[1].contains("/double/action") && warnings[1].contains("values"),
        "{warnings:?}"
    );
}

/// A channel's record is damaged.
#[test]
fn undefined_channel_does_not_hide_other_messages() {
    let scratch = TempDir::new().unwrap();
    let options = WriteOptions::new()
        .compression(None)
        .calculate_chunk_crcs(false)
        .emit_summary_records(false);
    let mut file = McapFile {
        writer: options.create(std::io::Cursor::new(Vec::new())).unwrap(),
    };
    let string = ("std_msgs/msg/String", "ros2msg", "string data");
    file.channel("/a", Some(string), "cdr", &[text("1"), text("2")]);
    file.channel("/damaged", Some(string), "cdr", &[text("x"), text("y")]);
    file.channel("/c", Some(string), "cdr", &[text("3")]);
    let path = file.write(&scratch);
    let mut bytes = fs::read(&path).unwrap();
    let topic = bytes
        .windows(8)
        .position(|window| window == b"/damaged")
        .unwrap();
    // The topic follows opcode, length, two ids and its own length.
    assert_eq!(bytes[topic - 17], 4);
    bytes[topic - 17] = 0x90;
    fs::write(&path, bytes).unwrap();
    let reader = BagReader::open(&path).unwrap();
    let (good, bad): (Vec<_>, Vec<_>) = reader.messages().partition(Result::is_ok);
    assert_eq!((good.len(), bad.len()), (3, 1));
    let error = bad[0].as_ref().unwrap_err().to_string();
    assert!(
        error.contains("undefined channel") && error.contains("1 more"),
        "{error}"
    );
}

/// MCAP can store times past 2^63 - 1 ns, rosbag2 cannot.
#[test]
fn message_past_rosbag2_time_is_skipped_by_name() {
    let scratch = TempDir::new().unwrap();
    let mut file = McapFile::new();
    let string = ("std_msgs/msg/String", "ros2msg", "string data");
    let channel_id = file.channel("/text", Some(string), "cdr", &[text("a")]);
    let header = MessageHeader {
        channel_id,
        sequence: 1,
        log_time: u64::MAX,
        publish_time: 0,
    };
    file.writer
        .write_to_known_channel(&header, &text("b"))
        .unwrap();
    let path = file.write(&scratch);
    assert_eq!(texts(&BagReader::open(&path).unwrap()), ["a", "b"]);
    let part = scratch.path().join("part");
    let all = TopicFilter::default();
    let cut = cut(&path, &part, CutStart::Beginning, CutEnd::End, &all).unwrap();
    assert_eq!(texts(&BagReader::open(&part).unwrap()), ["a"]);
    let skipped = cut.warnings.iter().filter(|warning| warning.is_loss());
    assert_eq!(skipped.count(), 1, "{:?}", cut.warnings);
}
