use std::time::Duration;

use tempfile::TempDir;
use wm_msgs::std_msgs::String as Text;

use super::*;
use crate::{BagReader, BagWarning};

const START_NS: u64 = 1_700_000_000_000_000_000;

/// Writes `count` texts on two topics, ten per second.
fn write(dir: &Path, options: WriterOptions, count: u64) -> BagSummary {
    let mut writer = BagWriter::create(dir, options).unwrap();
    writer
        .add_topic::<Text>("/instruction", QosProfile::latched())
        .unwrap();
    for number in 0..count {
        let text = Text {
            // Random, so that chunks do not compress to nothing.
            data: format!("{number} {}", number.wrapping_mul(0x9e37_79b9_7f4a_7c15)),
        };
        let topic = ["/even", "/odd"][number as usize % 2];
        writer
            .write(topic, &text, START_NS + number * 100_000_000)
            .unwrap();
    }
    writer.finish().unwrap()
}

fn times(bag: &Path) -> Vec<u64> {
    let reader = BagReader::open(bag).unwrap();
    assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
    reader
        .messages()
        .map(|message| message.unwrap().log_time_ns)
        .collect()
}

/// Checks the files `NAME_0.mcap` and so on: each has every topic, and together they have all messages in order.
fn check_split(dir: &Path, written: &BagSummary, count: u64) {
    let reader = BagReader::open(dir).unwrap();
    assert_eq!(&reader.summary(), written);
    let expected: Vec<u64> = (0..count)
        .map(|number| START_NS + number * 100_000_000)
        .collect();
    assert_eq!(times(dir), expected);
    let mut by_file = Vec::new();
    for (number, file) in written.files.iter().enumerate() {
        assert_eq!(file, &dir.join(format!("bag_{number}.mcap")));
        assert_eq!(BagReader::open(file).unwrap().topics().len(), 3);
        let times = times(file);
        assert!(!times.is_empty(), "{}", file.display());
        by_file.extend(times);
    }
    assert_eq!(by_file, expected);
    let metadata = Metadata::read(dir).unwrap().unwrap();
    assert_eq!(metadata.relative_file_paths.len(), written.files.len());
    for (file, listed) in written.files.iter().zip(&metadata.files) {
        let times = times(file);
        let (first, last) = (times[0], times[times.len() - 1]);
        assert_eq!(
            (
                listed.starting_time.nanoseconds_since_epoch,
                listed.duration.nanoseconds,
                listed.message_count
            ),
            (first as i64, (last - first) as i64, times.len() as u64)
        );
    }
}

#[test]
fn bag_is_split_by_duration() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        max_file_duration: Some(Duration::from_secs(1)),
        ..WriterOptions::default()
    };
    let written = write(&dir, options, 50);
    // As in rosbag2, the limit itself is included.
    assert_eq!(times(&written.files[0]).len(), 11);
    assert_eq!(written.files.len(), 5);
    check_split(&dir, &written, 50);
}

#[test]
fn bag_is_split_by_size() {
    const LIMIT: u64 = 6000;
    let scratch = TempDir::new().unwrap();
    for (number, compression) in [Compression::None, Compression::Lz4, Compression::Zstd]
        .into_iter()
        .enumerate()
    {
        let dir = scratch.path().join(number.to_string()).join("bag");
        let options = WriterOptions {
            max_file_bytes: Some(LIMIT),
            compression,
            ..WriterOptions::default()
        };
        let written = write(&dir, options, 500);
        assert!(written.files.len() > 2, "{written}");
        let (last, full) = written.files.split_last().unwrap();
        for file in full {
            let bytes = fs::metadata(file).unwrap().len();
            // The limit, and the summary.
            assert!((LIMIT..2 * LIMIT).contains(&bytes), "{bytes} bytes");
        }
        assert!(fs::metadata(last).unwrap().len() < 2 * LIMIT);
        check_split(&dir, &written, 500);
    }
}

#[test]
fn killed_writer_leaves_complete_files() {
    let scratch = TempDir::new().unwrap();
    let dir = scratch.path().join("bag");
    let options = WriterOptions {
        max_file_duration: Some(Duration::from_secs(1)),
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(&dir, options).unwrap();
    for number in 0..25 {
        let text = Text {
            data: number.to_string(),
        };
        writer
            .write("/text", &text, START_NS + number * 100_000_000)
            .unwrap();
    }
    // Like kill -9: no destructor runs, and buffers are lost.
    std::mem::forget(writer);
    let reader = BagReader::open(&dir).unwrap();
    assert!(
        reader
            .warnings()
            .contains(&BagWarning::NoMetadata { dir: dir.clone() })
    );
    assert_eq!(reader.message_count(), 22);
}

#[test]
fn chunks_are_on_the_disk_after_the_interval() {
    let scratch = TempDir::new().unwrap();
    let written = |interval: Option<Duration>| {
        let dir = scratch.path().join(format!("{interval:?}"));
        let options = WriterOptions {
            sync_interval: interval,
            ..WriterOptions::default()
        };
        let mut writer = BagWriter::create(dir, options).unwrap();
        let begun = writer.file.synced_bytes;
        let text = Text::default();
        writer.write("/text", &text, START_NS).unwrap();
        writer.flush().unwrap();
        let size = fs::metadata(
            writer
                .dir
                .read_dir()
                .unwrap()
                .next()
                .unwrap()
                .unwrap()
                .path(),
        );
        (begun, writer.file.synced_bytes, size.unwrap().len())
    };
    let (begun, synced, size) = written(Some(Duration::ZERO));
    assert!(begun > 0, "the file's beginning is on the disk at once");
    assert_eq!(synced, size);
    let (begun, synced, size) = written(Some(Duration::from_secs(3600)));
    assert!(synced == begun && begun > 0 && size > synced);
    assert_eq!(written(None).1, 0);
}

#[test]
fn presets_match_rosbag2() {
    let scratch = TempDir::new().unwrap();
    for (name, preset, compression, has_chunks) in [
        ("fastwrite", StoragePreset::FastWrite, "none", false),
        ("zstd_fast", StoragePreset::ZstdFast, "zstd", true),
        ("zstd_small", StoragePreset::ZstdSmall, "zstd", true),
    ] {
        let dir = scratch.path().join(name).join("bag");
        let options = WriterOptions {
            preset,
            ..WriterOptions::default()
        };
        let written = write(&dir, options, 100);
        assert_eq!(written.compression, compression, "{name}");
        check_split(&dir, &written, 100);
        let bytes = fs::read(&written.files[0]).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(!summary.chunk_indexes.is_empty(), has_chunks, "{name}");
    }
}
