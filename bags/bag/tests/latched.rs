//! Latched topics: at a time of a bag, in each file of a split, and by their names.

use tempfile::TempDir;
use wm_bag::{BagReader, BagWriter, QosProfile, WriterOptions, recover, type_schema};
use wm_msgs::{cdr, std_msgs::String as Text};

const S: u64 = 1_000_000_000;
const START_NS: u64 = 1_750_000_000 * S;

fn text(data: &str) -> Text {
    Text { data: data.into() }
}

/// Topic, text and log time \[s after the start\].
fn rows(messages: impl IntoIterator<Item = wm_bag::BagMessage>) -> Vec<(String, String, u64)> {
    let row = |message: wm_bag::BagMessage| {
        let text = message.decode::<Text>().unwrap().data;
        (
            message.topic.to_string(),
            text,
            (message.log_time_ns - START_NS) / S,
        )
    };
    messages.into_iter().map(row).collect()
}

fn row(topic: &str, text: &str, seconds: u64) -> (String, String, u64) {
    (topic.to_owned(), text.to_owned(), seconds)
}

/// Two static frames; an instruction that changes in the sixth second; a note each second.
fn write(writer: &mut BagWriter) {
    for topic in ["/tf_static", "/task/instruction"] {
        writer
            .add_topic::<Text>(topic, QosProfile::latched())
            .unwrap();
    }
    writer.write("/tf_static", &text("base"), START_NS).unwrap();
    writer
        .write("/tf_static", &text("camera"), START_NS)
        .unwrap();
    writer
        .write("/task/instruction", &text("push"), START_NS)
        .unwrap();
    for second in 0..10 {
        let time_ns = START_NS + second * S;
        if second == 6 {
            writer
                .write("/task/instruction", &text("pull"), time_ns)
                .unwrap();
        }
        writer
            .write("/note", &text(&second.to_string()), time_ns)
            .unwrap();
    }
}

#[test]
fn latched_messages_before_a_time_are_found() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        chunk_size: 20,
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&dir, options).unwrap();
    write(&mut writer);
    writer.finish().unwrap();
    let reader = BagReader::open(&dir).unwrap();
    let at = |seconds: u64| {
        let (messages, unreadable) = reader.latched_before(START_NS + seconds * S, |_| true);
        assert!(unreadable.is_empty());
        rows(messages)
    };
    let frames = [row("/tf_static", "base", 0), row("/tf_static", "camera", 0)];
    assert_eq!(
        at(6),
        [&[row("/task/instruction", "push", 0)], &frames[..]].concat()
    );
    assert_eq!(
        at(7),
        [&[row("/task/instruction", "pull", 6)], &frames[..]].concat()
    );
    assert_eq!(at(0), []);
    let (none, _) = reader.latched_before(u64::MAX, |topic| &*topic.name == "/note");
    assert_eq!(none, []);
}

#[test]
fn each_file_starts_with_latched_messages() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        max_file_duration: Some(std::time::Duration::from_secs(3)),
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&dir, options).unwrap();
    write(&mut writer);
    let summary = writer.finish().unwrap();
    assert_eq!((summary.files.len(), summary.message_count), (3, 14));
    let file = |number: usize| {
        let reader = BagReader::open(&summary.files[number]).unwrap();
        rows(reader.messages().map(Result::unwrap))
    };
    let begin = |instruction: &str, seconds: u64| {
        [
            row("/task/instruction", instruction, seconds),
            row("/tf_static", "base", seconds),
            row("/tf_static", "camera", seconds),
        ]
    };
    assert_eq!(
        file(1)[..4],
        [&begin("push", 4)[..], &[row("/note", "4", 4)]].concat()
    );
    assert_eq!(
        file(2)[..4],
        [&begin("pull", 8)[..], &[row("/note", "8", 8)]].concat()
    );

    // The whole bag has each message once, also after recovery.
    let recovered = scratch.path().join("recovered");
    recover(&dir, &recovered).unwrap();
    for dir in [dir, recovered] {
        let reader = BagReader::open(&dir).unwrap();
        assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
        let all = rows(reader.messages().map(Result::unwrap));
        assert_eq!((all.len() as u64, reader.message_count()), (14, 14));
        let instructions = all
            .iter()
            .filter(|(topic, ..)| topic == "/task/instruction");
        assert_eq!(instructions.count(), 2);
        assert!(reader.summary().notes.is_empty());
    }
}

#[test]
fn same_message_published_twice_is_kept_twice() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let mut writer = BagWriter::create(&dir, WriterOptions::default()).unwrap();
    let latched = QosProfile::latched();
    writer
        .add_topic::<Text>("/task/instruction", latched)
        .unwrap();
    for second in 0..3 {
        let time_ns = START_NS + second * S;
        writer
            .write("/task/instruction", &text("push"), time_ns)
            .unwrap();
        writer.split().unwrap();
    }
    writer.finish().unwrap();
    let reader = BagReader::open(&dir).unwrap();
    assert_eq!(reader.messages().count(), 3);
}

#[test]
fn known_topics_without_qos_are_latched() {
    let scratch = TempDir::new().unwrap();
    for (number, qos) in ["", "[]", "not: [yaml"].into_iter().enumerate() {
        let dir = scratch.path().join(number.to_string());
        let mut writer = BagWriter::create(&dir, WriterOptions::default()).unwrap();
        let data = cdr::to_bytes(&text("x")).unwrap();
        for topic in [
            "/tf_static",
            "/arm/robot_description",
            "/task/instruction",
            "/camera",
        ] {
            let schema = type_schema::<Text>();
            writer
                .add_topic_raw(topic, "std_msgs/msg/String", &schema, qos)
                .unwrap();
            writer
                .write_raw(topic, "std_msgs/msg/String", &schema, START_NS, &data)
                .unwrap();
        }
        writer.finish().unwrap();
        let reader = BagReader::open(&dir).unwrap();
        let latched: Vec<bool> = reader
            .topics()
            .iter()
            .map(wm_bag::TopicInfo::is_latched)
            .collect();
        assert_eq!(latched, [true, false, true, true], "{qos:?}");
    }
}
