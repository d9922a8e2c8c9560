//! Storages of rosbag2 other than plain MCAP: compressed files, compressed messages, sqlite3.

use std::{
    fs,
    path::{Path, PathBuf},
};

use rusqlite::{Connection, params};
use tempfile::TempDir;
use wm_bag::{
    BagReader, BagWarning, BagWriter, QosProfile, Schema, SchemaEncoding, WriterOptions, recover,
};
use wm_msgs::{
    cdr,
    std_msgs::{Bool, String as Text},
};

const START_NS: u64 = 1_750_000_000_000_000_000;

/// Writes a bag with ten numbered texts; returns its file.
fn mcap(dir: &Path, first: u64) -> PathBuf {
    let mut writer = BagWriter::create(dir, WriterOptions::default()).unwrap();
    for number in first..first + 10 {
        let data = number.to_string();
        writer
            .write("/text", &Text { data }, START_NS + number * 1_000_000)
            .unwrap();
    }
    writer.finish().unwrap().files.remove(0)
}

fn compress(from: &Path, to: &Path) {
    fs::write(
        to,
        zstd::bulk::compress(&fs::read(from).unwrap(), 1).unwrap(),
    )
    .unwrap();
}

fn texts(path: &Path) -> Vec<String> {
    let reader = BagReader::open(path).unwrap();
    let messages = reader.messages().map(Result::unwrap);
    messages
        .map(|message| message.decode::<Text>().unwrap().data)
        .collect()
}

fn numbers(range: std::ops::Range<u64>) -> Vec<String> {
    range.map(|number| number.to_string()).collect()
}

/// With the mode FILE, a killed rosbag2 leaves closed files compressed, the open one not.
#[test]
fn killed_recorder_with_file_compression_loses_nothing() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("killed");
    fs::create_dir(&dir).unwrap();
    for number in 0..3 {
        let file = mcap(&scratch.path().join(format!("part{number}")), number * 10);
        match number {
            2 => fs::rename(&file, dir.join("k_2.mcap")).unwrap(),
            _ => compress(&file, &dir.join(format!("k_{number}.mcap.zstd"))),
        }
    }
    assert_eq!(texts(&dir), numbers(0..30));
    let reader = BagReader::open(&dir).unwrap();
    let decompressed = |w: &&BagWarning| matches!(w, BagWarning::Decompressed { .. });
    assert_eq!(reader.warnings().iter().filter(decompressed).count(), 2);
    let recovered = scratch.path().join("recovered");
    let recovery = recover(&dir, &recovered).unwrap();
    assert!(recovery.losses.is_empty(), "{recovery}");
    assert_eq!(texts(&recovered), numbers(0..30));
    assert_eq!(
        fs::read_dir(&dir).unwrap().count(),
        3,
        "reading does not change the bag"
    );
}

#[test]
fn file_in_two_forms_is_read_once() {
    let scratch = TempDir::new().unwrap();
    let file = mcap(&scratch.path().join("bag"), 0);
    // As if the recorder was killed while it compressed.
    let whole = zstd::bulk::compress(&fs::read(&file).unwrap(), 1).unwrap();
    fs::write(file.with_extension("mcap.zstd"), &whole[..whole.len() / 2]).unwrap();
    fs::remove_file(file.with_file_name("metadata.yaml")).unwrap();
    let dir = file.parent().unwrap();
    assert_eq!(texts(dir), numbers(0..10));
    let reader = BagReader::open(dir).unwrap();
    assert!(
        reader
            .warnings()
            .iter()
            .any(|w| matches!(w, BagWarning::Twice { .. }))
    );
}

#[test]
fn truncated_compressed_file_is_read_to_its_end() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        chunk_size: 2000,
        compression: wm_bag::Compression::None,
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&dir, options).unwrap();
    for number in 0..2000_u64 {
        let data = format!("{number} {:x}", number.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        writer
            .write("/text", &Text { data }, START_NS + number)
            .unwrap();
    }
    let file = writer.finish().unwrap().files.remove(0);
    let mut encoder = zstd::stream::write::Encoder::new(Vec::new(), 1).unwrap();
    // Finished blocks can be read, as of a recorder that compresses while it writes.
    for part in fs::read(&file).unwrap().chunks(20_000) {
        std::io::Write::write_all(&mut encoder, part).unwrap();
        std::io::Write::flush(&mut encoder).unwrap();
    }
    let whole = encoder.finish().unwrap();
    let cut = scratch.path().join("cut.mcap.zstd");
    fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    let reader = BagReader::open(&cut).unwrap();
    let is_loss = |warning: &BagWarning| warning.is_loss();
    assert!(
        reader.warnings().iter().any(is_loss),
        "{:?}",
        reader.warnings()
    );
    assert!(
        (500..1500).contains(&reader.message_count()),
        "{}",
        reader.message_count()
    );
}

#[test]
fn listed_files_are_found_compressed_or_not() {
    for (listed, there) in [
        ("bag_0.mcap.zstd", "bag_0.mcap"),
        ("old/bag_0.mcap", "bag_0.mcap.zstd"),
    ] {
        let scratch = TempDir::new().unwrap();
        let dir = scratch.path().join("bag");
        let file = mcap(&dir, 0);
        if there != "bag_0.mcap" {
            compress(&file, &dir.join(there));
            fs::remove_file(&file).unwrap();
        }
        let metadata = dir.join("metadata.yaml");
        let text = fs::read_to_string(&metadata).unwrap();
        let text = text.replace("- bag_0.mcap", &format!("- {listed}"));
        let text = text.replace("compression_mode: ''", "compression_mode: FILE");
        let text = text.replace("compression_format: ''", "compression_format: zstd");
        fs::write(&metadata, text).unwrap();
        assert_eq!(texts(&dir), numbers(0..10), "{listed} {there}");
    }
}

#[test]
fn other_files_are_read_if_one_is_missing() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    mcap(&dir, 0);
    let metadata = dir.join("metadata.yaml");
    let text = fs::read_to_string(&metadata).unwrap();
    fs::write(
        &metadata,
        text.replace("- bag_0.mcap", "- bag_0.mcap\n  - bag_1.mcap"),
    )
    .unwrap();
    assert_eq!(texts(&dir), numbers(0..10));
    let reader = BagReader::open(&dir).unwrap();
    let missing = |w: &BagWarning| matches!(w, BagWarning::MissingFile { .. }) && w.is_loss();
    assert!(reader.warnings().iter().any(missing));
}

/// In the mode MESSAGE, rosbag2 compresses each message, and the file itself does not record it.
#[test]
fn compressed_messages_are_read_and_recovered_plain() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let schema = wm_bag::type_schema::<Text>();
    let mut writer = BagWriter::create(&dir, WriterOptions::default()).unwrap();
    for number in 0..10_u64 {
        let data = number.to_string();
        let plain = cdr::to_bytes(&Text { data }).unwrap();
        let mut frame = zstd::bulk::compress(&plain, 1).unwrap();
        if number == 5 {
            frame.truncate(frame.len() - 3);
        }
        let time_ns = START_NS + number;
        writer
            .write_raw("/text", "std_msgs/msg/String", &schema, time_ns, &frame)
            .unwrap();
    }
    let file = writer.finish().unwrap().files.remove(0);
    let reader = BagReader::open(&file).unwrap();
    let (good, bad): (Vec<_>, Vec<_>) = reader.messages().partition(Result::is_ok);
    assert_eq!((good.len(), bad.len()), (9, 1));
    assert_eq!(
        good[8].as_ref().unwrap().decode::<Text>().unwrap().data,
        "9"
    );
    assert!(bad[0].as_ref().unwrap_err().to_string().contains("/text"));
    let recovered = scratch.path().join("recovered");
    let recovery = recover(&file, &recovered).unwrap();
    assert_eq!(recovery.losses.messages, 1);
    assert_eq!(texts(&recovered).len(), 9);
}

/// The tables of each version of rosbag2's schema (`rosbag2_storage_sqlite3`).
fn tables(version: u32) -> String {
    let (mut columns, mut more) = (String::new(), String::new());
    if version >= 2 {
        columns += ", offered_qos_profiles TEXT NOT NULL";
    }
    if version >= 3 {
        more += "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
                 CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);";
    }
    if version >= 4 {
        columns += ", type_description_hash TEXT NOT NULL";
        more += "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
                 encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);";
    }
    format!(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
         serialization_format TEXT NOT NULL{columns});
         CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
         CREATE INDEX timestamp_idx ON messages (timestamp ASC); {more}"
    )
}

/// A file with `messages` texts on one topic, and flags on another.
fn sqlite(path: &Path, version: u32, messages: i64) {
    let file = Connection::open(path).unwrap();
    fill(&file, version, messages);
}

fn fill(file: &Connection, version: u32, messages: i64) {
    file.execute_batch(&tables(version)).unwrap();
    let latched = QosProfile::latched().to_yaml();
    for (id, name, type_name) in [
        (1, "/text", "std_msgs/msg/String"),
        (7, "/task/success", "std_msgs/msg/Bool"),
        (9, "/json", "foxglove.Scene"),
    ] {
        let mut values = format!("{id}, '{name}', '{type_name}', 'cdr'");
        if version >= 2 {
            values += &format!(", '{latched}'");
        }
        if version >= 4 {
            values += ", 'RIHS01_00'";
        }
        file.execute(&format!("INSERT INTO topics VALUES ({values})"), [])
            .unwrap();
    }
    if version >= 4 {
        let definition = "INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', 'string data', '')";
        file.execute(definition, []).unwrap();
    }
    // One transaction waits for the disk only once.
    file.execute_batch("BEGIN").unwrap();
    let mut insert = file
        .prepare("INSERT INTO messages VALUES (?1, ?2, ?3, ?4)")
        .unwrap();
    for number in 0..messages {
        let data = cdr::to_bytes(&Text {
            data: number.to_string(),
        })
        .unwrap();
        // Every fourth is late.
        let late = if number % 4 == 0 { 3_500_000 } else { 0 };
        let time = START_NS as i64 + number * 1_000_000 - late;
        insert.execute(params![number + 1, 1, time, data]).unwrap();
    }
    let flag = cdr::to_bytes(&Bool { data: true }).unwrap();
    insert
        .execute(params![messages + 1, 7, START_NS as i64 - 5_000_000, flag])
        .unwrap();
    drop(insert);
    file.execute_batch("COMMIT").unwrap();
}

fn ordered(messages: u64) -> Vec<String> {
    let mut all: Vec<u64> = (0..messages).collect();
    all.sort_by_key(|n| n * 1_000_000 + 10_000_000 - if n % 4 == 0 { 3_500_000 } else { 0 });
    all.iter().map(ToString::to_string).collect()
}

#[test]
fn sqlite_bags_of_every_version_are_read_in_log_order() {
    for version in 1..=4 {
        let scratch = TempDir::new().unwrap();
        let dir = scratch.path().join("bag");
        fs::create_dir(&dir).unwrap();
        sqlite(&dir.join("bag_0.db3"), version, 5000);
        let reader = BagReader::open(&dir).unwrap();
        assert_eq!(reader.message_count(), 5001);
        assert_eq!(reader.summary().storage, "sqlite3");
        let messages: Vec<_> = reader.messages().map(Result::unwrap).collect();
        assert!(messages[0].decode::<Bool>().unwrap().data);
        let read: Vec<String> = messages[1..]
            .iter()
            .map(|message| message.decode::<Text>().unwrap().data)
            .collect();
        assert_eq!(read, ordered(5000));
        let topic = reader.topic("/text").unwrap();
        assert_eq!(
            topic.schema.encoding,
            SchemaEncoding::Ros2Msg,
            "carried, or known"
        );
        assert_eq!(topic.qos(), (version >= 2).then(QosProfile::latched));
        assert!(reader.topic("/task/success").unwrap().is_latched());
        let skipped = |w: &BagWarning| matches!(w, BagWarning::ChannelSkipped { .. });
        assert!(reader.warnings().iter().any(skipped));
        let from = reader.messages().starting_at(START_NS + 4_990_000_000);
        assert_eq!(from.count(), 9);
        assert_eq!(
            fs::read_dir(&dir).unwrap().count(),
            1,
            "reading creates no files"
        );
    }
}

#[test]
fn compressed_sqlite_file_is_read() {
    let scratch = TempDir::new().unwrap();
    let plain = scratch.path().join("bag_0.db3");
    sqlite(&plain, 4, 20);
    let compressed = scratch.path().join("with space %41?.db3.zstd");
    compress(&plain, &compressed);
    assert_eq!(BagReader::open(&compressed).unwrap().messages().count(), 21);
    let odd = scratch.path().join("odd #1 %41?.db3");
    fs::rename(&plain, &odd).unwrap();
    assert_eq!(BagReader::open(&odd).unwrap().messages().count(), 21);
}

/// A killed recorder leaves its last messages in the write-ahead log.
#[test]
fn journal_of_a_killed_recorder_is_read_from_a_copy() {
    let scratch = TempDir::new().unwrap();
    let (open, dir) = (scratch.path().join("open"), scratch.path().join("killed"));
    fs::create_dir(&open).unwrap();
    fs::create_dir(&dir).unwrap();
    let file = Connection::open(open.join("bag_0.db3")).unwrap();
    file.pragma_update(None, "journal_mode", "WAL").unwrap();
    file.pragma_update(None, "wal_autocheckpoint", 0).unwrap();
    fill(&file, 4, 50);
    for name in ["bag_0.db3", "bag_0.db3-wal"] {
        fs::copy(open.join(name), dir.join(name)).unwrap();
    }
    drop(file);
    let before: Vec<u64> = ["bag_0.db3", "bag_0.db3-wal"]
        .map(|name| fs::metadata(dir.join(name)).unwrap().len())
        .into();
    let reader = BagReader::open(&dir).unwrap();
    assert_eq!(reader.messages().count(), 51);
    assert!(
        reader
            .warnings()
            .iter()
            .any(|w| matches!(w, BagWarning::Journal { .. }))
    );
    let after: Vec<u64> = ["bag_0.db3", "bag_0.db3-wal"]
        .map(|name| fs::metadata(dir.join(name)).unwrap().len())
        .into();
    assert_eq!((before, fs::read_dir(&dir).unwrap().count()), (after, 2));
}

#[test]
fn damaged_sqlite_files_give_messages_or_an_error() {
    let scratch = TempDir::new().unwrap();
    let path = scratch.path().join("bag_0.db3");
    sqlite(&path, 4, 2000);
    let whole = fs::read(&path).unwrap();
    let mut read_in_part = false;
    for part in 1..20 {
        // Truncated, then with flipped bits.
        fs::write(&path, &whole[..whole.len() * part / 20]).unwrap();
        let mut flipped = whole.clone();
        for at in (100 + part * 7..whole.len()).step_by(whole.len() / 5) {
            flipped[at] ^= 0x55;
        }
        for bytes in [fs::read(&path).unwrap(), flipped] {
            fs::write(&path, bytes).unwrap();
            let Ok(reader) = BagReader::open(&path) else {
                continue;
            };
            let read = reader.messages().filter(Result::is_ok).count();
            read_in_part |= (1..2001).contains(&read);
        }
    }
    assert!(read_in_part);
    // A view could compute without end.
    fs::remove_file(&path).unwrap();
    let file = Connection::open(&path).unwrap();
    file.execute_batch(
        "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT);
         CREATE VIEW messages AS WITH RECURSIVE x(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM x)
         SELECT id, 1 AS topic_id, 1 AS timestamp, zeroblob(9) AS data FROM x;",
    )
    .unwrap();
    drop(file);
    let error = BagReader::open(&path).unwrap_err().to_string();
    assert!(error.contains("without a table of messages"), "{error}");
}

/// A definition of this machine must not be used for bytes that it does not fit.
#[test]
fn sqlite_bags_get_only_definitions_that_fit() {
    let scratch = TempDir::new().unwrap();
    let path = scratch.path().join("bag_0.db3");
    let file = Connection::open(&path).unwrap();
    file.execute_batch(&tables(1)).unwrap();
    file.execute(
        "INSERT INTO topics VALUES (1, '/wm/action', 'wm_msgs/msg/Action', 'cdr')",
        [],
    )
    .unwrap();
    let foreign = [&[0, 1, 0, 0][..], &[0; 40]].concat();
    file.execute("INSERT INTO messages VALUES (1, 1, 5, ?1)", [foreign])
        .unwrap();
    drop(file);
    let reader = BagReader::open(&path).unwrap();
    assert_eq!(
        reader.topics()[0].schema.as_ref(),
        &Schema {
            encoding: SchemaEncoding::Other(String::new()),
            text: String::new(),
        }
    );
    let message = reader.messages().next().unwrap().unwrap();
    assert!(message.decode::<wm_msgs::wm_msgs::Action>().is_err());
}
