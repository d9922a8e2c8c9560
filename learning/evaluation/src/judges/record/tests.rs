use super::*;
use crate::judges::verdict::SuccessScore;

fn entry(key: &str, outcome: Outcome) -> Entry {
    Entry {
        key: key.to_owned(),
        stamp_ns: 5,
        judge: "a".to_owned(),
        instruction: "close oven".to_owned(),
        trial: 0,
        frames: vec![0],
        request: serde_json::json!({"model": "m"}),
        answers: vec![Answer {
            seed: Some(0),
            temperature: Some(0.0),
            text: "Final\nScore: 1".to_owned(),
            finish_reason: None,
            model: None,
            usage: Some(Usage {
                input_tokens: 10,
                output_tokens: 2,
            }),
            attempts: 1,
            problem: None,
        }],
        outcome,
    }
}

fn success() -> Outcome {
    Outcome::Success(SuccessScore::Success)
}

#[test]
fn record_is_written_by_line_and_resumed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("answers.jsonl");
    let mut record = Record::open(&path).unwrap();
    assert!(record.is_empty());
    record.append(entry("k1", success())).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(
        text.lines().count(),
        2,
        "on the disk while the record is still open"
    );
    record
        .append(entry("k2", Outcome::Unusable("no score".to_owned())))
        .unwrap();
    record
        .append(entry("k3", Outcome::Interrupted("no answer".to_owned())))
        .unwrap();
    let tally = record.tally("a");
    drop(record);

    let record = Record::open(&path).unwrap();
    assert_eq!(record.len(), 2);
    assert_eq!(record.outcome("k1"), Some(&success()));
    assert!(record.outcome("k2").is_some() && record.outcome("k3").is_none());
    assert_eq!(record.tally("a"), tally);
    assert_eq!(
        (
            tally.usage.input_tokens,
            tally.largest.input_tokens,
            tally.unusable
        ),
        (30, 10, 1)
    );
    assert_eq!(record.tally("b"), Tally::default());
}

#[test]
fn incomplete_last_line_is_dropped() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("answers.jsonl");
    let mut record = Record::open(&path).unwrap();
    record.append(entry("k1", success())).unwrap();
    record.append(entry("k2", success())).unwrap();
    drop(record);
    let whole = std::fs::read(&path).unwrap();
    for length in 0..whole.len() {
        std::fs::write(&path, &whole[..length]).unwrap();
        let mut record = Record::open(&path).unwrap();
        let lines = whole[..length].iter().filter(|b| **b == b'\n').count();
        assert_eq!(record.len(), lines.saturating_sub(1), "cut at {length}");
        record.append(entry("k3", success())).unwrap();
        drop(record);
        assert!(Record::open(&path).unwrap().outcome("k3").is_some());
    }
}

#[test]
fn other_files_stay_unchanged() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notes.txt");
    let texts = [
        "my notes",
        "my notes\n",
        "{}\n",
        "{\"wm_judge_record\":10}\n",
        "\n",
    ];
    for text in texts {
        std::fs::write(&path, text).unwrap();
        let error = Record::open(&path).unwrap_err();
        assert!(
            matches!(error, Error::NotARecord { .. }),
            "{text:?}: {error}"
        );
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }
    assert!(matches!(
        Record::open(dir.path()),
        Err(Error::Record { .. })
    ));
}

#[test]
fn damaged_line_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("answers.jsonl");
    let text = format!("{HEADER}\n{{\"key\": 1}}\n{{\n");
    std::fs::write(&path, &text).unwrap();
    let error = Record::open(&path).unwrap_err().to_string();
    assert!(error.contains("line 2"), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
}

#[test]
fn only_one_process_writes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("answers.jsonl");
    let record = Record::open(&path).unwrap();
    assert!(matches!(
        Record::open(&path),
        Err(Error::RecordInUse { .. })
    ));
    drop(record);
    Record::open(&path).unwrap();
}
