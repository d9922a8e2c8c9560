use proptest::prelude::*;

use super::*;

fn names(columns: &[(String, Column)]) -> Vec<&str> {
    columns.iter().map(|(name, _)| name.as_str()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn rows_are_read_from_any_range_of_row_groups(
        groups in prop::collection::vec(prop::collection::vec(any::<i64>(), 1..6), 1..5),
        bounds in (0.0f64..1.0, 0.0f64..1.0),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.parquet");
        let columns = |values: &[i64]| vec![
            ("whole".to_owned(), Column::Integers(values.to_vec())),
            ("text".to_owned(), Column::Texts(values.iter().map(i64::to_string).collect())),
            ("row".to_owned(), Column::FloatRows {
                width: 2,
                values: values.iter().flat_map(|v| [*v as f32, 1.0]).collect(),
            }),
            ("image".to_owned(), Column::DoubleLists {
                depth: 3,
                rows: values.iter().map(|v| vec![*v as f64, 2.0, 3.0]).collect(),
            }),
        ];
        let mut writer = TableWriter::create(&path, &columns(&groups[0]), &[("key", "value".into())]).unwrap();
        for group in &groups {
            writer.write(&columns(group)).unwrap();
        }
        writer.finish().unwrap();
        let all = groups.concat();
        let table = Table::open(&path).unwrap();
        prop_assert_eq!(table.row_count(), all.len() as u64);
        prop_assert_eq!(table.text_column(), Some("text"));
        let at = |share: f64| (share * (all.len() + 1) as f64) as u64;
        let range = at(bounds.0.min(bounds.1))..at(bounds.0.max(bounds.1));
        let mut rows = Vec::new();
        // In another order than in the file.
        table.rows(&["image", "whole", "row", "text"], range.clone(), |row, cells| {
            let whole = integer("whole", cells.get(1))?;
            assert_eq!(numbers("image", cells.first(), 3)?, [whole as f64, 2.0, 3.0]);
            assert_eq!(numbers("row", cells.get(2), 2)?, [f64::from(whole as f32), 1.0]);
            assert_eq!(text("text", cells.get(3))?, whole.to_string());
            rows.push((row, whole));
            Ok(())
        }).unwrap();
        let expected: Vec<(u64, i64)> = range.map(|row| (row, all[row as usize])).collect();
        prop_assert_eq!(rows, expected);
    }
}

#[test]
fn invalid_cells_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bad.parquet");
    let columns = [
        (
            "vector".to_owned(),
            Column::FloatRows {
                width: 2,
                values: vec![1.0, f32::NAN],
            },
        ),
        ("flag".to_owned(), Column::Booleans(vec![true])),
    ];
    let mut writer = TableWriter::create(&path, &columns, &[]).unwrap();
    writer.write(&columns).unwrap();
    writer.finish().unwrap();
    let table = Table::open(&path).unwrap();
    assert_eq!(names(&columns), table.columns().collect::<Vec<_>>());
    let error = |columns: &[&str], end: u64, read: &dyn Fn(&[Field]) -> Result<(), String>| {
        let result = table.rows(columns, 0..end, |_, cells| read(cells));
        result.unwrap_err().to_string()
    };
    for (error, part) in [
        (
            error(&["vector"], 1, &|cells| {
                numbers("vector", cells.first(), 2).map(drop)
            }),
            "row 0: vector: expected a finite number, got NaN",
        ),
        (
            error(&["vector"], 1, &|cells| {
                numbers("vector", cells.first(), 3).map(drop)
            }),
            "vector: expected a finite number",
        ),
        (
            error(&["flag"], 1, &|cells| {
                integer("flag", cells.first()).map(drop)
            }),
            "row 0: flag: expected a whole number, got true",
        ),
        (
            error(&["flag"], 1, &|cells| {
                picture("flag", cells.first()).map(drop)
            }),
            "flag: expected an image's bytes or path",
        ),
        (
            error(&["other"], 1, &|_| Ok(())),
            "expected a column \"other\", but it has vector, flag",
        ),
        (
            error(&["flag"], 2, &|_| Ok(())),
            "expected rows 0 to 2, but it has 1",
        ),
    ] {
        assert!(
            error.contains("bad.parquet") && error.contains(part),
            "{part:?} in {error:?}"
        );
    }
}
