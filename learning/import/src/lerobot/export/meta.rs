use std::{fs, path::Path};

use serde_json::{Value, json};

use crate::lerobot::{
    LeRobotError,
    info::TASK_INDEX,
    table::{Column, TableWriter},
};

/// Writes `meta/tasks.parquet`: the texts are the index of a pandas table, declared in its metadata.
pub(super) fn write_tasks(root: &Path, tasks: &[String]) -> Result<(), LeRobotError> {
    const TASK: &str = "task";
    let numbers = (0..tasks.len()).map(|number| number as i64).collect();
    let columns = [
        (TASK_INDEX.to_owned(), Column::Integers(numbers)),
        (TASK.to_owned(), Column::Texts(tasks.to_vec())),
    ];
    // See pandas' developer guide, "Storing pandas DataFrame objects in Apache Parquet format".
    let pandas = json!({
        "index_columns": [TASK],
        "column_indexes": [{
            "name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"},
        }],
        "columns": [
            {"name": TASK_INDEX, "field_name": TASK_INDEX, "pandas_type": "int64",
             "numpy_type": "int64", "metadata": null},
            {"name": TASK, "field_name": TASK, "pandas_type": "unicode",
             "numpy_type": "object", "metadata": null},
        ],
        "creator": {"library": "wm_lerobot", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.0.0",
    });
    let path = root.join("meta/tasks.parquet");
    let mut table = TableWriter::create(&path, &columns, &[("pandas", pandas.to_string())])?;
    table.write(&columns)?;
    table.finish()
}

/// A cell of a row.
pub(super) fn int(name: &str, value: u64) -> (String, Column) {
    let value = i64::try_from(value).unwrap_or(i64::MAX);
    (name.to_owned(), Column::Integers(vec![value]))
}

/// A cell of a row.
pub(super) fn double(name: &str, value: f64) -> (String, Column) {
    (name.to_owned(), Column::Doubles(vec![value]))
}

/// Writes JSON like LeRobot: indented, with unescaped UTF-8.
pub(super) fn write_json(path: &Path, value: &Value) -> Result<(), LeRobotError> {
    let text = format!("{value:#}\n");
    fs::write(path, text).map_err(|source| LeRobotError::io(path, source))
}
