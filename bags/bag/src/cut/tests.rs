use std::{path::PathBuf, time::Duration};

use tempfile::TempDir;
use wm_msgs::std_msgs::String as Text;

use super::*;
use crate::QosProfile;

const START_NS: u64 = 1_700_000_000_000_000_000;
const SECOND_NS: u64 = 1_000_000_000;

/// Ten seconds with one text per second; a latched instruction in the first and in the seventh.
fn bag(scratch: &TempDir) -> PathBuf {
    let dir = scratch.path().join("bag");
    let mut writer = BagWriter::create(
        &dir,
        WriterOptions {
            chunk_size: 40,
            ..WriterOptions::default()
        },
    )
    .unwrap();
    writer.note("action_space", "two_joints");
    writer
        .add_topic::<Text>("/instruction", QosProfile::latched())
        .unwrap();
    for second in 0..10 {
        let text = |what: &str| Text {
            data: format!("{what} {second}"),
        };
        let time_ns = START_NS + second * SECOND_NS;
        if second == 0 || second == 6 {
            writer.write("/instruction", &text("do"), time_ns).unwrap();
        }
        writer.write("/text", &text("at"), time_ns).unwrap();
    }
    writer.finish().unwrap();
    dir
}

/// Topic, text and log time \[s after the start\].
fn contents(bag: &Path) -> Vec<(String, String, f64)> {
    let reader = BagReader::open(bag).unwrap();
    assert!(reader.warnings().is_empty(), "{:?}", reader.warnings());
    reader
        .messages()
        .map(|message| {
            let message = message.unwrap();
            let text = message.decode::<Text>().unwrap().data;
            let seconds = (message.log_time_ns - START_NS) as f64 / 1e9;
            (message.topic.to_string(), text, seconds)
        })
        .collect()
}

fn row(topic: &str, text: &str, seconds: f64) -> (String, String, f64) {
    (topic.to_owned(), text.to_owned(), seconds)
}

#[test]
fn part_starts_with_latched_messages() {
    let scratch = TempDir::new().unwrap();
    let old = bag(&scratch);
    let new = scratch.path().join("new");
    let (start, end) = (
        CutStart::After(Duration::from_millis(1500)),
        CutEnd::After(Duration::from_millis(2500)),
    );
    let part = cut(&old, &new, start, end, &TopicFilter::default()).unwrap();
    assert_eq!(part.latched, ["/instruction"]);
    assert_eq!(
        contents(&new),
        [
            row("/instruction", "do 0", 1.5),
            row("/text", "at 2", 2.0),
            row("/text", "at 3", 3.0)
        ]
    );
    let reader = BagReader::open(&new).unwrap();
    let first = reader.messages().next().unwrap().unwrap();
    assert_eq!(first.publish_time_ns, START_NS);
    assert_eq!(reader.note("action_space"), Some("two_joints"));
    assert_eq!(part.summary.notes, reader.summary().notes);
    assert_eq!(
        reader.topic("/instruction").unwrap().qos(),
        Some(QosProfile::latched())
    );
    let sequences: Vec<u32> = reader
        .stored_messages(|messages| messages)
        .map(|message| message.unwrap().header.sequence)
        .collect();
    assert_eq!(sequences, [1, 3, 4], "sequence numbers stay");
}

#[test]
fn times_and_topics_select_messages() {
    let scratch = TempDir::new().unwrap();
    let old = bag(&scratch);
    let new = scratch.path().join("new");
    let only_text = TopicFilter::new(vec!["/text".into()], None, vec![], None).unwrap();
    let (start, end) = (CutStart::At(START_NS + 8 * SECOND_NS), CutEnd::End);
    let part = cut(&old, &new, start, end, &only_text).unwrap();
    assert!(part.latched.is_empty());
    assert_eq!(
        contents(&new),
        [row("/text", "at 8", 8.0), row("/text", "at 9", 9.0)]
    );

    let whole = scratch.path().join("whole");
    cut(
        &old,
        &whole,
        CutStart::Beginning,
        CutEnd::End,
        &TopicFilter::default(),
    )
    .unwrap();
    assert_eq!(contents(&whole), contents(&old));

    let failure = |start, end, topics: &TopicFilter| {
        let never = scratch.path().join("never");
        let error = cut(&old, &never, start, end, topics).unwrap_err();
        assert!(!never.exists());
        error.to_string()
    };
    let (start, end) = (CutStart::After(Duration::from_secs(60)), CutEnd::End);
    assert!(failure(start, end, &only_text).contains("has no messages from"));
    let missing = TopicFilter::new(vec!["/missing".into()], None, vec![], None).unwrap();
    let error = failure(CutStart::Beginning, CutEnd::End, &missing);
    assert!(
        error.contains("/missing") && error.contains("/text"),
        "{error}"
    );
}
