use std::{
    collections::{BTreeMap, HashSet},
    io::Cursor,
};

use mcap::{WriteOptions, records::MessageHeader};
use proptest::prelude::*;
use tempfile::TempDir;

use super::*;
use crate::{BagReader, Compression, reader::chunk::record_header};

const START_NS: u64 = 1_700_000_000_000_000_000;

/// A message: topic, sequence number, log time, publish time, bytes.
type Row = (String, u32, u64, u64, Vec<u8>);

fn rows(bag: &Path) -> Vec<Row> {
    let reader = BagReader::open(bag).unwrap();
    // Outside chunks, definitions have no checksum.
    let is_of_definition = |warning: &BagWarning| {
        matches!(
            warning,
            BagWarning::UnreadableDefinition { .. }
                | BagWarning::OtherFields { .. }
                | BagWarning::Undecodable { .. }
        )
    };
    let warnings = reader.warnings();
    assert!(warnings.iter().all(is_of_definition), "{warnings:?}");
    let topics: HashMap<(usize, u16), String> = reader
        .definitions()
        .map(|(file, channel)| ((file, channel.id), channel.topic.clone()))
        .collect();
    reader
        .stored_messages(|messages| messages)
        .map(|message| {
            let message = message.unwrap();
            let header = message.header;
            (
                topics[&(message.file, header.channel_id)].clone(),
                header.sequence,
                header.log_time,
                header.publish_time,
                message.data.to_vec(),
            )
        })
        .collect()
}

/// An MCAP file with two topics and `per_chunk` messages per chunk; and its messages, by chunk.
fn file(options: WriteOptions, chunks: u64, per_chunk: u64) -> (Vec<u8>, Vec<Vec<Row>>) {
    let options = options.profile("ros2").chunk_size(None);
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let schema = writer
        .add_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        .unwrap();
    let metadata = BTreeMap::from([
        ("offered_qos_profiles".to_owned(), "[]".to_owned()),
        ("topic_type_hash".to_owned(), "RIHS01_00".to_owned()),
    ]);
    let channels = ["/a", "/b"].map(|topic| {
        let id = writer.add_channel(schema, topic, "cdr", &metadata).unwrap();
        (topic, id)
    });
    let mut written = Vec::new();
    for chunk in 0..chunks {
        let mut of_chunk = Vec::new();
        for number in chunk * per_chunk..(chunk + 1) * per_chunk {
            let (topic, channel_id) = channels[number as usize % 2];
            let data = [&[0, 1, 0, 0][..], &number.to_le_bytes(), &[7; 20]].concat();
            let header = MessageHeader {
                channel_id,
                sequence: 1000 + number as u32,
                log_time: START_NS + number,
                publish_time: START_NS - 5 + number,
            };
            writer.write_to_known_channel(&header, &data).unwrap();
            of_chunk.push((
                topic.to_owned(),
                header.sequence,
                header.log_time,
                header.publish_time,
                data,
            ));
        }
        writer.flush().unwrap();
        written.push(of_chunk);
    }
    writer.finish().unwrap();
    (writer.into_inner().into_inner(), written)
}

fn zstd() -> WriteOptions {
    WriteOptions::new().compression(Some(mcap::Compression::Zstd))
}

/// Recovers a file of these bytes.
fn recovered(scratch: &Path, bytes: &[u8]) -> Result<(Recovery, Vec<Row>), BagError> {
    let (damaged, output) = (scratch.join("damaged.mcap"), scratch.join("out"));
    fs::write(&damaged, bytes).unwrap();
    if output.exists() {
        fs::remove_dir_all(&output).unwrap();
    }
    let recovery = recover(&damaged, &output)?;
    let rows = rows(&output);
    assert_eq!(recovery.summary.message_count, rows.len() as u64);
    if !rows.is_empty() {
        // The reader judges definitions, the writer does not; `rows` has checked its warnings.
        let read = BagReader::open(&output).unwrap().summary();
        let written = BagSummary {
            warnings: read.warnings.clone(),
            ..recovery.summary.clone()
        };
        assert_eq!(read, written);
    }
    Ok((recovery, rows))
}

#[test]
fn recovered_topic_names_are_absolute() {
    let scratch = TempDir::new().unwrap();
    let mut writer = WriteOptions::new()
        .profile("ros2")
        .create(Cursor::new(Vec::new()))
        .unwrap();
    let schema = writer
        .add_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        .unwrap();
    let channel_id = writer
        .add_channel(schema, "a", "cdr", &BTreeMap::new())
        .unwrap();
    let header = MessageHeader {
        channel_id,
        sequence: 1,
        log_time: START_NS,
        publish_time: START_NS,
    };
    writer
        .write_to_known_channel(&header, &[0, 1, 0, 0, 1, 0, 0, 0, 0])
        .unwrap();
    writer.finish().unwrap();
    let bytes = writer.into_inner().into_inner();
    let (recovery, rows) = recovered(scratch.path(), &bytes).unwrap();
    assert_eq!(recovery.summary.topics[0].name, "/a");
    assert_eq!(rows.len(), 1);
}

/// First byte and end of each chunk.
fn chunk_places(bytes: &[u8]) -> Vec<(usize, usize)> {
    let mut places = Vec::new();
    let mut at = mcap::MAGIC.len();
    while let Some((opcode, length)) = record_header(&bytes[at..]) {
        let end = at + RECORD_HEADER_BYTES as usize + length as usize;
        match opcode {
            op::CHUNK => places.push((at, end)),
            op::DATA_END => break,
            _ => {}
        }
        at = end;
    }
    places
}

#[test]
fn undamaged_bag_is_copied() {
    let scratch = TempDir::new().unwrap();
    let (bytes, written) = file(zstd(), 3, 4);
    let (recovery, rows) = recovered(scratch.path(), &bytes).unwrap();
    assert!(recovery.losses.is_empty(), "{recovery}");
    assert!(recovery.without_end.is_empty(), "{recovery}");
    assert_eq!(rows, written.concat());
    let reader = BagReader::open(scratch.path().join("out")).unwrap();
    let (_, channel) = reader.definitions().next().unwrap();
    assert_eq!(channel.metadata["offered_qos_profiles"], "[]");
    assert_eq!(channel.metadata["topic_type_hash"], "RIHS01_00");
    let schema = channel.schema.as_ref().unwrap();
    assert_eq!(
        (schema.name.as_str(), &schema.data[..]),
        ("std_msgs/msg/String", &b"string data\n"[..])
    );
}

#[test]
fn file_cut_at_any_byte_keeps_whole_chunks() {
    let scratch = TempDir::new().unwrap();
    let (bytes, written) = file(zstd(), 4, 3);
    let places = chunk_places(&bytes);
    assert_eq!(places.len(), 4);
    for end in 0..bytes.len() {
        let whole = places.iter().filter(|(_, behind)| *behind <= end).count();
        let is_within = places.iter().any(|(at, behind)| *at < end && end < *behind);
        match recovered(scratch.path(), &bytes[..end]) {
            Ok((recovery, rows)) => {
                assert_eq!(rows, written[..whole].concat(), "cut at {end}");
                assert!(
                    is_within != recovery.losses.is_empty() || whole == 0,
                    "cut at {end}: {recovery}"
                );
                assert!(!recovery.without_end.is_empty(), "cut at {end}: {recovery}");
            }
            Err(error) => assert!(end < mcap::MAGIC.len(), "cut at {end}: {error}"),
        }
    }
}

/// Flips bits at `at`: all messages of other chunks are recovered, and no invented ones.
fn survives_flip(scratch: &Path, bytes: &[u8], written: &[Vec<Row>], at: usize, bits: u8) {
    let mut damaged = bytes.to_vec();
    damaged[at] ^= bits;
    let (recovery, rows) = match recovered(scratch, &damaged) {
        Ok(found) => found,
        Err(error) => panic!("flip of {bits:#04x} at {at}: {error}"),
    };
    let places = chunk_places(bytes);
    let hit = places
        .iter()
        .position(|(start, end)| (*start..*end).contains(&at));
    let others = written
        .iter()
        .enumerate()
        .filter(|(number, _)| Some(*number) != hit);
    let expected: Vec<Row> = others.flat_map(|(_, rows)| rows.clone()).collect();
    let all = written.concat();
    let context = format!("flip of {bits:#04x} at {at}, chunk {hit:?}: {recovery}");
    let found: HashSet<&Row> = rows.iter().collect();
    assert!(expected.iter().all(|row| found.contains(row)), "{context}");
    assert!(rows.iter().all(|row| all.contains(row)), "{context}");
    assert!(
        rows.len() == all.len() || !recovery.losses.is_empty(),
        "{context}"
    );
}

#[test]
fn flipped_byte_costs_at_most_its_chunk() {
    let scratch = TempDir::new().unwrap();
    for options in [zstd(), WriteOptions::new().compression(None)] {
        let (bytes, written) = file(options, 3, 3);
        for at in 0..bytes.len() {
            for bits in [0x01, 0x80, 0xff] {
                survives_flip(scratch.path(), &bytes, &written, at, bits);
            }
        }
    }
}

#[test]
fn messages_outside_chunks_are_kept_up_to_damage() {
    let scratch = TempDir::new().unwrap();
    let (bytes, written) = file(WriteOptions::new().use_chunks(false), 1, 20);
    let (recovery, rows) = recovered(scratch.path(), &bytes).unwrap();
    assert!(recovery.losses.is_empty(), "{recovery}");
    assert_eq!(rows, written.concat());
    let mut before = 0;
    for end in mcap::MAGIC.len()..bytes.len() {
        let (_, rows) = recovered(scratch.path(), &bytes[..end]).unwrap();
        assert!(
            rows.len() >= before && written.concat().starts_with(&rows),
            "cut at {end}"
        );
        before = rows.len();
    }
    assert_eq!(before, 20);
}

#[test]
fn all_files_of_a_folder_are_recovered_with_loss_counts() {
    let scratch = TempDir::new().unwrap();
    let old = scratch.path().join("old");
    let options = WriterOptions {
        chunk_size: 100,
        compression: Compression::Lz4,
        max_file_bytes: Some(1500),
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&old, options).unwrap();
    for number in 0..100u64 {
        let text = wm_msgs::std_msgs::String {
            data: format!("{number} {}", "x".repeat(50)),
        };
        writer.write("/text", &text, START_NS + number).unwrap();
    }
    writer.count_lost("/text", 3);
    writer.note("action_space", "two_joints");
    let summary = writer.finish().unwrap();
    assert!(summary.files.len() > 3, "{summary}");
    let all = rows(&old);
    // The first file is empty, as after a power cut; the last lacks its end.
    fs::write(&summary.files[0], b"").unwrap();
    let last = summary.files.last().unwrap();
    let bytes = fs::read(last).unwrap();
    fs::write(last, &bytes[..bytes.len() - 20]).unwrap();

    let new = scratch.path().join("new");
    let recovery = recover(&old, &new).unwrap();
    assert_eq!(recovery.summary.files.len(), summary.files.len() - 1);
    assert_eq!(recovery.losses.places, 1, "{recovery}");
    assert_eq!(recovery.without_end, std::slice::from_ref(last));
    assert_eq!(recovery.summary.lost["/text"], 3);
    let reader = BagReader::open(&new).unwrap();
    assert_eq!(reader.note("action_space"), Some("two_joints"));
    assert_eq!(recovery.summary.compression, "lz4");
    let found = rows(&new);
    assert!(all.ends_with(&found) && found.len() > 50, "{recovery}");

    let refused = |mode: &str| {
        let yaml = fs::read_to_string(old.join("metadata.yaml")).unwrap();
        let yaml = yaml.replace("compression_mode: ''", &format!("compression_mode: {mode}"));
        fs::write(old.join("metadata.yaml"), yaml).unwrap();
        recover(&old, scratch.path().join("never"))
            .unwrap_err()
            .to_string()
    };
    assert!(refused("FILE").contains("file compression"));
    assert!(!scratch.path().join("never").exists());
}

#[test]
fn damaged_index_is_not_recovered_as_message() {
    let scratch = TempDir::new().unwrap();
    let (bytes, written) = file(zstd(), 3, 2);
    let mut at = mcap::MAGIC.len();
    let mut damaged = 0;
    while let Some((opcode, length)) = record_header(&bytes[at..]) {
        if opcode == mcap::records::op::MESSAGE_INDEX {
            let mut bytes = bytes.clone();
            bytes[at] = mcap::records::op::MESSAGE;
            let (_, rows) = recovered(scratch.path(), &bytes).unwrap();
            assert_eq!(rows, written.concat());
            damaged += 1;
        }
        at += 9 + length as usize;
        if opcode == mcap::records::op::FOOTER {
            break;
        }
    }
    assert_eq!(damaged, 6, "an index for each topic of each chunk");
}

#[test]
fn files_other_than_bags_are_rejected() {
    let scratch = TempDir::new().unwrap();
    for bytes in [&b""[..], b"some text that is no bag", b"SQLite format 3\0"] {
        assert!(recovered(scratch.path(), bytes).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_damage_gives_written_messages_or_an_error(
        chunks in 1u64..6,
        per_chunk in 1u64..6,
        is_compressed: bool,
        cut in 0.0f64..=1.0,
        flips in prop::collection::vec((0.0f64..1.0, 1u8..=255), 0..6),
    ) {
        let scratch = TempDir::new().unwrap();
        let options = if is_compressed { zstd() } else { WriteOptions::new().compression(None) };
        let (mut bytes, written) = file(options, chunks, per_chunk);
        for (share, bits) in flips {
            let at = (share * bytes.len() as f64) as usize;
            bytes[at] ^= bits;
        }
        bytes.truncate((cut * bytes.len() as f64) as usize);
        let all: HashSet<Vec<u8>> = written.concat().into_iter().map(|row| row.4).collect();
        if let Ok((_, rows)) = recovered(scratch.path(), &bytes) {
            prop_assert!(rows.iter().all(|row| all.contains(&row.4)));
        }
    }

    #[test]
    fn recover_survives_arbitrary_bytes(noise in prop::collection::vec(any::<u8>(), 0..400)) {
        let scratch = TempDir::new().unwrap();
        let _ = recovered(scratch.path(), &[mcap::MAGIC, &noise].concat());
    }
}
