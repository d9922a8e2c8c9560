//! Wrong log times: in chunks, summaries and of the clock itself.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use tempfile::TempDir;
use wm_bag::{
    BagReader, BagWarning, BagWriter, CutEnd, CutStart, QosProfile, TopicFilter, WriterOptions, cut,
};
use wm_msgs::std_msgs::String as Text;

const S: u64 = 1_000_000_000;
const START_NS: u64 = 1_750_000_000 * S;

/// Writes a bag of one file with a text at each of these times, in this order; returns the file.
fn bag(folder: &Path, times: impl IntoIterator<Item = u64>) -> PathBuf {
    let options = WriterOptions {
        chunk_size: 60,
        ..WriterOptions::default()
    };
    let mut writer = BagWriter::create(folder, options).unwrap();
    for (number, time_ns) in times.into_iter().enumerate() {
        let data = format!("message {number}");
        writer.write("/text", &Text { data }, time_ns).unwrap();
    }
    writer.finish().unwrap().files.remove(0)
}

fn times(path: &Path) -> Vec<u64> {
    let reader = BagReader::open(path).unwrap();
    let messages = reader.messages().map(Result::unwrap);
    messages.map(|message| message.log_time_ns).collect()
}

/// Body offset and opcode of each top-level record.
fn records(bytes: &[u8]) -> Vec<(usize, u8)> {
    let (mut at, mut records) = (8, Vec::new());
    while at + 9 < bytes.len() - 8 {
        records.push((at + 9, bytes[at]));
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    records
}

/// Changes the records of these opcodes.
fn change(file: &Path, opcodes: &[u8], edit: impl Fn(&mut [u8])) {
    let mut bytes = fs::read(file).unwrap();
    for (at, opcode) in records(&bytes) {
        if opcodes.contains(&opcode) {
            edit(&mut bytes[at..]);
        }
    }
    fs::write(file, bytes).unwrap();
}

const CHUNK: u8 = 6;
const MESSAGE_INDEX: u8 = 7;
const CHUNK_INDEX: u8 = 8;
const STATISTICS: u8 = 11;

fn seconds() -> impl Iterator<Item = u64> {
    (0..30).map(|second| START_NS + second * S)
}

#[test]
fn wrong_chunk_times_do_not_change_reading() {
    let swap = |body: &mut [u8]| body[..16].rotate_left(8);
    let front = |body: &mut [u8]| body[..16].copy_from_slice(&[0; 16]);
    type Edit<'a> = (&'a [u8], &'a dyn Fn(&mut [u8]));
    let edits: [Edit<'_>; 4] = [
        (&[CHUNK_INDEX], &front),
        (&[CHUNK, CHUNK_INDEX], &swap),
        (&[CHUNK], &front),
        (&[MESSAGE_INDEX], &|body| {
            body[6..14].copy_from_slice(&[9; 8]);
        }),
    ];
    for (number, (opcodes, edit)) in edits.into_iter().enumerate() {
        let scratch = TempDir::new().unwrap();
        let file = bag(&scratch.path().join("bag"), seconds());
        change(&file, opcodes, edit);
        let expected: Vec<u64> = seconds().collect();
        assert_eq!(times(&file), expected, "edit {number}");
        let reader = BagReader::open(&file).unwrap();
        assert_eq!(
            (reader.start_ns(), reader.end_ns()),
            (START_NS, START_NS + 29 * S)
        );
        let part = scratch.path().join("part");
        let (start, end) = (
            CutStart::After(Duration::from_secs(10)),
            CutEnd::After(Duration::from_secs(3)),
        );
        cut(&file, &part, start, end, &TopicFilter::default()).unwrap();
        assert_eq!(times(&part), &expected[10..13], "edit {number}");
        let is_told = |warning: &BagWarning| matches!(warning, BagWarning::WrongSummary { .. });
        // A wrong message index alone changes nothing.
        assert_eq!(
            reader.warnings().iter().any(is_told),
            opcodes != [MESSAGE_INDEX]
        );
    }
}

#[test]
fn wrong_statistics_are_reported() {
    let scratch = TempDir::new().unwrap();
    let file = bag(&scratch.path().join("bag"), seconds());
    // The message count; then the first and the last time.
    change(&file, &[STATISTICS], |body| {
        body[..8].copy_from_slice(&5_000_000_u64.to_le_bytes());
        body[26..42].copy_from_slice(&[255; 16]);
    });
    let reader = BagReader::open(&file).unwrap();
    assert_eq!(
        (reader.message_count(), reader.end_ns()),
        (30, START_NS + 29 * S)
    );
    let warning = reader.warnings()[0].to_string();
    assert!(
        warning.contains("counts 5000000 messages, the file has 30"),
        "{warning}"
    );
    assert!(warning.contains("log times"), "{warning}");
}

#[test]
fn lengths_beyond_a_record_take_no_memory() {
    let scratch = TempDir::new().unwrap();
    let file = bag(&scratch.path().join("bag"), seconds());
    let whole = fs::read(&file).unwrap();
    for (opcode, at) in [
        (3, 2),
        (4, 4),
        (CHUNK, 28),
        (CHUNK_INDEX, 32),
        (STATISTICS, 42),
    ] {
        fs::write(&file, &whole).unwrap();
        change(&file, &[opcode], |body| {
            body[at..at + 4].copy_from_slice(&[255; 4]);
        });
        // Memory is bounded by the file: the memory limit of the process would show a violation.
        if let Ok(reader) = BagReader::open(&file) {
            reader.messages().for_each(drop);
        }
    }
}

#[test]
fn messages_at_time_zero_are_reported_and_skip_offsets() {
    for outlier in [0, 2 * START_NS] {
        let scratch = TempDir::new().unwrap();
        let dir = scratch.path().join("bag");
        let mut writer = BagWriter::create(&dir, WriterOptions::default()).unwrap();
        let frames = Text {
            data: "frames".into(),
        };
        writer
            .add_topic::<Text>("/tf_static", QosProfile::latched())
            .unwrap();
        writer.write("/tf_static", &frames, outlier).unwrap();
        for time_ns in seconds() {
            writer.write("/text", &frames, time_ns).unwrap();
        }
        writer.finish().unwrap();
        let reader = BagReader::open(&dir).unwrap();
        assert_eq!(
            reader.summary().main_span_ns,
            Some((START_NS, START_NS + 29 * S))
        );
        assert_eq!(reader.summary().duration_ns(), 29 * S);
        assert_eq!(reader.time_at(Duration::from_secs(2)), START_NS + 2 * S);
        let texts: Vec<String> = reader.warnings().iter().map(ToString::to_string).collect();
        let found = texts
            .iter()
            .any(|text| text.contains("1 message(s) were logged more than a day"));
        assert!(found, "{texts:?}");
        let part = scratch.path().join("part");
        let (start, end) = (
            CutStart::After(Duration::from_secs(27)),
            CutEnd::After(Duration::from_secs(5)),
        );
        let kept = cut(&dir, &part, start, end, &TopicFilter::default()).unwrap();
        assert_eq!(kept.latched.len(), usize::from(outlier == 0));
        assert_eq!(kept.summary.message_count, 3 + u64::from(outlier == 0));
    }
}

#[test]
fn backward_clock_step_is_reported_with_its_place() {
    let scratch = TempDir::new().unwrap();
    let back = START_NS - 7200 * S;
    let all = seconds().chain((0..5).map(|second| back + second * S));
    let file = bag(&scratch.path().join("bag"), all);
    let reader = BagReader::open(&file).unwrap();
    let steps: Vec<_> = reader
        .warnings()
        .iter()
        .filter_map(|warning| match warning {
            BagWarning::StepsBack {
                steps, first_ns, ..
            } => Some((*steps, *first_ns)),
            _ => None,
        })
        .collect();
    assert_eq!(steps, [(1, (START_NS + 29 * S, back))]);
    let gaps: Vec<(u64, u64)> = reader.gaps_ns().collect();
    assert_eq!(gaps, [(back + 4 * S, START_NS)]);
    assert!(
        reader
            .warnings()
            .iter()
            .any(|w| matches!(w, BagWarning::Gaps { gaps: 1, .. }))
    );
    let read = times(&file);
    assert!(read.is_sorted() && read.len() == 35);
}

#[test]
fn messages_late_by_seconds_are_sorted_without_warning() {
    let scratch = TempDir::new().unwrap();
    let late = (0..60_u64).map(|number| START_NS + (number ^ 5) * S / 5);
    let file = bag(&scratch.path().join("bag"), late);
    let reader = BagReader::open(&file).unwrap();
    assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
    assert!(times(&file).is_sorted());
}
