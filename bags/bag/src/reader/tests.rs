use std::{collections::HashSet, io::Cursor, time::Duration};

use bytes::Bytes;
use mcap::WriteOptions;
use proptest::prelude::*;
use tempfile::TempDir;
use wm_msgs::std_msgs::{Bool, String as Text};

use super::*;
use crate::{BagWriter, Compression, QosProfile, WriterOptions, type_schema};

const START_NS: u64 = 1_700_000_000_000_000_000;

/// CDR of a distinct text.
fn text(number: u64) -> Vec<u8> {
    wm_msgs::cdr::to_bytes(&Text {
        data: format!("message {number} {}", "x".repeat(number as usize % 50)),
    })
    .unwrap()
}

/// Writes a bag with `count` texts on two topics, in small chunks that overlap in time.
fn write_bag(dir: &Path, count: u64, options: WriterOptions) -> Vec<(u64, Bytes)> {
    let mut writer = BagWriter::create(dir, options).unwrap();
    let schema = type_schema::<Text>();
    let mut written = Vec::new();
    for number in 0..count {
        // Every fourth message is late: out of order across chunks.
        let log_time_ns = START_NS
            + if number % 4 == 0 {
                number.saturating_sub(20)
            } else {
                number
            } * 1_000_000;
        let data = text(number);
        writer
            .write_raw(
                if number % 3 == 0 { "/odd" } else { "/even" },
                "std_msgs/msg/String",
                &schema,
                log_time_ns,
                &data,
            )
            .unwrap();
        written.push((log_time_ns, Bytes::from(data)));
    }
    writer.finish().unwrap();
    written.sort_by_key(|(time, _)| *time);
    written
}

fn small_chunks(compression: Compression) -> WriterOptions {
    WriterOptions {
        chunk_size: 300,
        compression,
        ..WriterOptions::default()
    }
}

fn read_all(path: &Path) -> Vec<(u64, Bytes)> {
    let reader = BagReader::open(path).unwrap();
    reader
        .messages()
        .map(|message| message.unwrap())
        .map(|message| (message.log_time_ns, message.data))
        .collect()
}

fn only_mcap(dir: &Path) -> PathBuf {
    numbered_files(dir).unwrap().0.remove(0)
}

#[test]
fn messages_come_in_log_time_order_with_their_bytes() {
    let scratch = TempDir::new().unwrap();
    for (number, compression) in [Compression::None, Compression::Lz4, Compression::Zstd]
        .into_iter()
        .enumerate()
    {
        let dir = scratch.path().join(format!("bag{number}"));
        let written = write_bag(&dir, 200, small_chunks(compression));
        assert_eq!(read_all(&dir), written);
        assert_eq!(read_all(&only_mcap(&dir)), written, "a lone .mcap");
        let reader = BagReader::open(&dir).unwrap();
        assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
        assert_eq!(reader.message_count(), 200);
        assert_eq!(
            (reader.start_ns(), reader.end_ns()),
            (START_NS, START_NS + 199_000_000)
        );
        assert!(
            reader.index[0].segments.len() > 10,
            "the test needs many chunks"
        );
        let counts: Vec<(&str, u64)> = reader
            .topics()
            .iter()
            .map(|topic| (&*topic.name, topic.message_count))
            .collect();
        assert_eq!(counts, [("/even", 133), ("/odd", 67)]);
        assert_eq!(
            reader.summary().compression,
            ["none", "lz4", "zstd"][number]
        );
    }
}

#[test]
fn topics_and_start_limit_messages() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let written = write_bag(&dir, 100, small_chunks(Compression::None));
    let reader = BagReader::open(&dir).unwrap();
    let from = START_NS + 50_000_000;
    let expected: Vec<u64> = written
        .iter()
        .map(|(time, _)| *time)
        .filter(|time| *time >= from)
        .collect();
    let got: Vec<u64> = reader
        .messages()
        .starting_at(from)
        .map(|message| message.unwrap().log_time_ns)
        .collect();
    assert_eq!(got, expected);
    let odd: Vec<_> = reader
        .messages()
        .only_topics(["/odd"])
        .map(Result::unwrap)
        .collect();
    assert_eq!(odd.len(), 34);
    assert!(odd.iter().all(|message| &*message.topic == "/odd"));
    assert_eq!(reader.messages().only_topics(["/absent"]).count(), 0);
}

#[test]
fn typed_messages_and_qos_survive_a_round_trip() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let mut writer = BagWriter::create(&dir, WriterOptions::default()).unwrap();
    writer
        .add_topic::<Bool>("/task/success", QosProfile::latched())
        .unwrap();
    writer
        .add_topic::<Text>("/silent", QosProfile::sensor_data())
        .unwrap();
    writer
        .write("/task/success", &Bool { data: true }, START_NS)
        .unwrap();
    writer
        .write(
            "/text",
            &Text {
                data: "hello".into(),
            },
            START_NS,
        )
        .unwrap();
    writer.count_lost("/text", 3);
    let conflict = writer
        .write("/text", &Bool { data: true }, START_NS)
        .unwrap_err();
    assert!(
        matches!(conflict, BagError::TypeConflict { .. }),
        "{conflict}"
    );
    let written = writer.finish().unwrap();

    let reader = BagReader::open(&dir).unwrap();
    assert_eq!(reader.summary(), written);
    assert_eq!(reader.summary().lost["/text"], 3);
    let qos = |topic| reader.topic(topic).unwrap().qos().unwrap();
    assert_eq!(qos("/task/success"), QosProfile::latched());
    assert_eq!(qos("/silent"), QosProfile::sensor_data());
    assert_eq!(qos("/text"), QosProfile::reliable());
    // From ROS 2 Kilted: share/std_msgs/msg/String.json.
    let text_hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    let hash = |reader: &BagReader, topic| reader.topic(topic).unwrap().type_hash.to_string();
    assert_eq!(hash(&reader, "/text"), text_hash);
    assert_eq!(hash(&reader, "/silent"), text_hash, "from metadata.yaml");
    let file = BagReader::open(only_mcap(&dir)).unwrap();
    assert_eq!(hash(&file, "/text"), text_hash, "from the file alone");
    let yaml = fs::read_to_string(dir.join("metadata.yaml")).unwrap();
    assert_eq!(
        yaml.matches(&format!("type_description_hash: {text_hash}\n"))
            .count(),
        2
    );
    assert_eq!(reader.topic("/silent").unwrap().message_count, 0);
    assert_eq!(
        *reader.topic("/text").unwrap().schema,
        type_schema::<Text>()
    );
    let messages: Vec<_> = reader.messages().map(Result::unwrap).collect();
    assert_eq!(messages[0].decode::<Bool>().unwrap(), Bool { data: true });
    assert_eq!(messages[1].decode::<Text>().unwrap().data, "hello");
    assert!(matches!(
        messages[1].decode::<Bool>(),
        Err(BagError::WrongType { .. })
    ));
}

#[test]
fn same_messages_give_same_bytes() {
    let scratch = TempDir::new().unwrap();
    let bytes = |name: &str| {
        let dir = scratch.path().join(name).join("bag");
        write_bag(&dir, 50, WriterOptions::default());
        (
            fs::read(only_mcap(&dir)).unwrap(),
            fs::read(dir.join("metadata.yaml")).unwrap(),
        )
    };
    assert_eq!(bytes("a"), bytes("b"));
}

#[test]
fn killed_writer_loses_at_most_the_open_chunk() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        chunk_duration: Some(Duration::from_secs(1)),
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&dir, options).unwrap();
    for number in 0..38 {
        writer
            .write(
                "/text",
                &Text {
                    data: number.to_string(),
                },
                START_NS + number * 100_000_000,
            )
            .unwrap();
    }
    // Like kill -9: no destructor runs, and buffers are lost.
    std::mem::forget(writer);
    let reader = BagReader::open(&dir).unwrap();
    assert!(reader.truncated());
    assert!(
        reader
            .warnings()
            .contains(&BagWarning::NoMetadata { dir: dir.clone() })
    );
    // Chunks of 1 s are closed by their eleventh message: 3 chunks, and 5 messages in the open one.
    assert_eq!(reader.message_count(), 33);
    assert_eq!(reader.messages().map(Result::unwrap).count(), 33);
}

/// An MCAP file of the library's writer, with options that ours does not use.
fn foreign_file(options: WriteOptions, messages: u64) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let schema = writer
        .add_schema("std_msgs/String", "ros2msg", b"string data")
        .unwrap();
    let channel = writer
        .add_channel(schema, "/text", "cdr", &BTreeMap::new())
        .unwrap();
    for number in 0..messages {
        let time = START_NS + number;
        let header = mcap::records::MessageHeader {
            channel_id: channel,
            sequence: 0,
            log_time: time,
            publish_time: time,
        };
        writer
            .write_to_known_channel(&header, &text(number))
            .unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn files_without_chunks_or_summary_are_read() {
    let scratch = TempDir::new().unwrap();
    let plain = || WriteOptions::new().profile("ros2");
    for (name, options) in [
        ("no chunks", plain().use_chunks(false)),
        (
            "no summary",
            plain().chunk_size(Some(300)).emit_summary_records(false),
        ),
        (
            "neither",
            plain().use_chunks(false).emit_summary_records(false),
        ),
        (
            "no chunk index",
            plain().chunk_size(Some(300)).emit_chunk_indexes(false),
        ),
        (
            "no channels in the summary",
            plain().chunk_size(Some(300)).repeat_channels(false),
        ),
        (
            "no message index",
            plain().chunk_size(Some(300)).emit_message_indexes(false),
        ),
    ] {
        let path = scratch.path().join(format!("{name}.mcap"));
        fs::write(&path, foreign_file(options, 60)).unwrap();
        let reader = BagReader::open(&path).unwrap();
        assert_eq!(reader.message_count(), 60, "{name}");
        assert_eq!(&*reader.topics()[0].type_name, "std_msgs/msg/String");
        assert!(!reader.truncated(), "{name}: {:?}", reader.warnings());
        let read = read_all(&path);
        let written: Vec<_> = (0..60)
            .map(|number| (START_NS + number, Bytes::from(text(number))))
            .collect();
        assert_eq!(read, written, "{name}");
    }
}

#[test]
fn several_files_are_one_bag() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    fs::create_dir(&dir).unwrap();
    let mut expected = Vec::new();
    for (number, file) in ["bag_0.mcap", "bag_1.mcap", "bag_10.mcap"]
        .iter()
        .enumerate()
    {
        let part = scratch.path().join(format!("part{number}"));
        expected.extend(write_bag(&part, 30, small_chunks(Compression::None)));
        fs::rename(only_mcap(&part), dir.join(file)).unwrap();
    }
    expected.sort_by_key(|(time, _)| *time);
    let names: Vec<_> = numbered_files(&dir)
        .unwrap()
        .0
        .iter()
        .map(|path| path.file_name().unwrap().to_owned())
        .collect();
    assert_eq!(names, ["bag_0.mcap", "bag_1.mcap", "bag_10.mcap"]);
    assert_eq!(read_all(&dir), expected);
}

#[test]
fn invalid_input_is_named() {
    let scratch = TempDir::new().unwrap();
    let at = |name: &str| scratch.path().join(name);
    let message = |path: &Path| BagReader::open(path).unwrap_err().to_string();
    let file = |name: &str, bytes: &[u8]| {
        fs::write(at(name), bytes).unwrap();
        message(&at(name))
    };
    assert!(message(&at("absent")).contains("no such file"));
    assert!(file("empty.mcap", b"").contains("0 bytes"));
    assert!(file("text.mcap", b"some text that is no bag").contains("expected an MCAP"));
    assert!(file("old.db3", b"SQLite format 3\0").contains("not a database"));
    assert!(file("old.bag", b"#ROSBAG V2.0\n").contains("ROS 1"));
    assert!(file("bag.mcap.zstd", &[0x28, 0xb5, 0x2f, 0xfd, 0]).contains("0 bytes"));
    fs::create_dir(at("nothing")).unwrap();
    assert!(message(&at("nothing")).contains("no .mcap"));

    let dir = at("bag");
    write_bag(&dir, 3, WriterOptions::default());
    assert!(matches!(
        BagWriter::create(&dir, WriterOptions::default()),
        Err(BagError::Exists(_))
    ));
    let yaml = fs::read_to_string(dir.join("metadata.yaml")).unwrap();
    let with = |from: &str, to: &str| {
        assert!(yaml.contains(from), "{from} in {yaml}");
        fs::write(dir.join("metadata.yaml"), yaml.replace(from, to)).unwrap();
    };
    with("compression_mode: ''", "compression_mode: FILE");
    assert!(message(&dir).contains("file compression"));
    with("compression_mode: ''", "compression_mode: message");
    assert!(message(&dir).contains("message compression"));
    with("storage_identifier: mcap", "storage_identifier: other");
    assert!(message(&dir).contains("stored as other"));
    with("- bag_0.mcap", "- bag_7.mcap");
    assert!(message(&dir).contains("bag_7.mcap"));
    with("message_count: 3", "message_count: 4");
    assert!(
        BagReader::open(&dir).unwrap().warnings()[0]
            .to_string()
            .contains("counts 4 messages")
    );
}

#[test]
fn bag_without_messages_opens() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    BagWriter::create(&dir, WriterOptions::default())
        .unwrap()
        .finish()
        .unwrap();
    let reader = BagReader::open(&dir).unwrap();
    assert_eq!(
        (
            reader.message_count(),
            reader.start_ns(),
            reader.messages().count()
        ),
        (0, 0, 0)
    );
    assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
}

#[test]
fn damaged_chunk_is_named_and_others_are_read() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    write_bag(&dir, 200, small_chunks(Compression::None));
    let file = only_mcap(&dir);
    let chunks = BagReader::open(&file).unwrap().index[0].segments.len();
    let mut bytes = fs::read(&file).unwrap();
    let needle = b"message 100 ";
    let at = bytes
        .windows(needle.len())
        .position(|window| window == needle)
        .unwrap();
    bytes[at] ^= 1;
    fs::write(&file, &bytes).unwrap();
    let (good, bad): (Vec<_>, Vec<_>) = BagReader::open(&dir)
        .unwrap()
        .messages()
        .partition(Result::is_ok);
    let [Err(error)] = &bad[..] else {
        panic!("one chunk is damaged, got {bad:?}")
    };
    assert!(error.to_string().contains("CRC"), "{error}");
    assert!(
        good.len() > 200 - 2 * 200 / chunks && good.len() < 200,
        "{} of 200 in {chunks} chunks",
        good.len()
    );
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let length = (body.len() as u64).to_le_bytes();
    [&[opcode][..], &length, body].concat()
}

/// A file of these data and summary records, with header, footer and magic.
fn crafted(data: &[u8], summary: &[u8]) -> Vec<u8> {
    let front = [
        mcap::MAGIC,
        &record(0x01, &[0; 8]),
        data,
        &record(0x0f, &[0; 4]),
    ]
    .concat();
    let start = if summary.is_empty() {
        0
    } else {
        front.len() as u64
    };
    let footer = [&start.to_le_bytes()[..], &[0; 12]].concat();
    [&front, summary, &record(0x02, &footer), mcap::MAGIC].concat()
}

#[test]
fn summary_with_foreign_records_is_ignored() {
    let scratch = TempDir::new().unwrap();
    let path = scratch.path().join("crafted.mcap");
    // An attachment too short for its checksum: the library would index out of bounds.
    fs::write(&path, crafted(&[], &record(0x09, &[0; 32]))).unwrap();
    let reader = BagReader::open(&path).unwrap();
    let warnings: Vec<String> = reader.warnings().iter().map(ToString::to_string).collect();
    assert!(
        warnings
            .iter()
            .any(|text| text.contains("is not allowed there")),
        "{warnings:?}"
    );
}

#[test]
fn warnings_about_damage_are_bounded() {
    let scratch = TempDir::new().unwrap();
    let path = scratch.path().join("crafted.mcap");
    fs::write(&path, crafted(&record(0x05, &[0; 3]).repeat(250), &[])).unwrap();
    let reader = BagReader::open(&path).unwrap();
    let damaged = reader.warnings();
    assert!(damaged.len() < 110, "{} warnings", damaged.len());
    assert!(damaged.contains(&BagWarning::MoreDamaged {
        file: path,
        places: 150
    }));
}

/// Opens a file of these bytes, reads all messages, and compares them with the written ones.
fn survives(
    scratch: &Path,
    bytes: &[u8],
    written: &HashSet<Bytes>,
) -> Result<usize, TestCaseError> {
    let path = scratch.join("cut.mcap");
    fs::write(&path, bytes).unwrap();
    let Ok(reader) = BagReader::open(&path) else {
        return Ok(0);
    };
    let mut read = 0;
    for message in reader.messages().flatten() {
        prop_assert!(
            written.contains(&message.data),
            "a message that was never written"
        );
        read += 1;
    }
    Ok(read)
}

#[test]
fn bag_cut_at_any_byte_keeps_whole_chunks() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let written: HashSet<Bytes> = write_bag(&dir, 24, small_chunks(Compression::Zstd))
        .into_iter()
        .map(|(_, data)| data)
        .collect();
    let bytes = fs::read(only_mcap(&dir)).unwrap();
    let mut before = 0;
    for end in 0..=bytes.len() {
        let read = survives(scratch.path(), &bytes[..end], &written).unwrap();
        assert!(
            read >= before,
            "cut at {end}: {read} messages, but {before} when cut one byte earlier"
        );
        before = read;
    }
    assert_eq!(before, 24);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn damaged_bag_gives_only_whole_messages(
        count in 1u64..80,
        chunk_size in 1u64..2000,
        cut in 0.0f64..1.0,
        flips in prop::collection::vec((0.0f64..1.0, 1u8..=255), 0..4),
    ) {
        let scratch = TempDir::new().unwrap();
        let dir = scratch.path().join("bag");
        let options = WriterOptions { chunk_size, compression: Compression::Lz4, ..WriterOptions::default() };
        let written: HashSet<Bytes> = write_bag(&dir, count, options).into_iter().map(|(_, data)| data).collect();
        let mut bytes = fs::read(only_mcap(&dir)).unwrap();
        let place = |share: f64| (share * bytes.len() as f64) as usize;
        survives(scratch.path(), &bytes[..place(cut)], &written)?;
        // Damage and truncation: the CRC of each chunk detects damage in it.
        let flips: Vec<(usize, u8)> = flips.into_iter().map(|(share, bits)| (place(share), bits)).collect();
        for (at, bits) in flips {
            bytes[at] ^= bits;
        }
        survives(scratch.path(), &bytes, &written)?;
    }
}

/// A power cut may leave a `metadata.yaml` that was renamed before its bytes were on the disk.
#[test]
fn damaged_metadata_does_not_hide_messages() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let written = write_bag(&dir, 50, small_chunks(Compression::None));
    let file = dir.join("metadata.yaml");
    let whole = fs::read(&file).unwrap();
    let half = whole[..whole.len() / 10].to_vec();
    for damaged in [
        Vec::new(),
        vec![0; 4096],
        half,
        b"\xff\xfe".to_vec(),
        b"just: yaml".to_vec(),
    ] {
        fs::write(&file, &damaged).unwrap();
        let reader = BagReader::open(&dir).unwrap();
        assert!(
            matches!(reader.warnings(), [BagWarning::BadMetadata { file: named, .. }] if *named == file),
            "{:?}",
            reader.warnings()
        );
        assert_eq!(read_all(&dir), written);
    }
    fs::remove_file(only_mcap(&dir)).unwrap();
    assert!(matches!(
        BagReader::open(&dir),
        Err(BagError::Metadata { .. })
    ));
}
